"""The photo warped and blended at a size of its own, as one compiled loop over pixels."""

import math

import numpy as np
from numpy.typing import NDArray

from mraa.compiled import compiled

STILL = np.float32(1 / 64)
"""Pixels; a shift below this leaves the photo's pixel as it is."""

SHOWN = np.float32(0.998)
"""Occlusion above which nothing generated is added: less than half of one 8-bit step."""


@compiled
def _cubic(t: float) -> tuple[float, float, float, float]:
    """Catmull-Rom weights of four neighbours, at `t` in [0, 1) after the second."""
    half = np.float32(0.5)
    s = np.float32(1.0) - t
    a, d = -half * t * s * s, -half * s * t * t
    c = half * t * (np.float32(1.0) + t * (np.float32(4.0) - np.float32(3.0) * t))
    return a, np.float32(1.0) - a - c - d, c, d


@compiled
def _sample(photo: NDArray[np.uint8], x: float, y: float) -> tuple[float, float, float]:
    """Colour of the photo at pixel (x, y), bicubic; outside lie its edges, continued."""
    height, width = photo.shape[:2]
    x = min(max(x, np.float32(-4.0)), np.float32(width + 3))
    y = min(max(y, np.float32(-4.0)), np.float32(height + 3))
    column, row = math.floor(x), math.floor(y)
    across = _cubic(x - np.float32(column))
    down = _cubic(y - np.float32(row))
    left, top = np.int64(column) - 1, np.int64(row) - 1
    inside = left >= 0 and top >= 0 and left + 3 < width and top + 3 < height
    red, green, blue = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for j in range(4):
        at = top + j if inside else min(max(top + j, 0), height - 1)
        line = photo[at]
        r, g, b = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        for i in range(4):
            to = left + i if inside else min(max(left + i, 0), width - 1)
            r += across[i] * np.float32(line[to, 0])
            g += across[i] * np.float32(line[to, 1])
            b += across[i] * np.float32(line[to, 2])
        red += down[j] * r
        green += down[j] * g
        blue += down[j] * b
    return red, green, blue


@compiled
def _row(
    image: NDArray[np.float32], places: NDArray[np.int32], weights: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:  # fmt: skip
    """A row between the rows of `image` (h, n): the weighted sum of four, (n,)."""
    a, b, c, d = weights[0], weights[1], weights[2], weights[3]
    p, q, r, s = image[places[0]], image[places[1]], image[places[2]], image[places[3]]
    for i in range(len(out)):
        out[i] = a * p[i] + b * q[i] + c * r[i] + d * s[i]


@compiled
def _between(
    line: NDArray[np.float32], places: NDArray[np.int32], weights: NDArray[np.float32]
) -> tuple[float, float, float]:
    """Three channels between four pixels of a row (3 * w,)."""
    x, y, z = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for k in range(4):
        first, weight = 3 * places[k], weights[k]
        x += weight * line[first]
        y += weight * line[first + 1]
        z += weight * line[first + 2]
    return x, y, z


@compiled
def draw(
    photo: NDArray[np.uint8],
    origin: tuple[int, int],
    maps: NDArray[np.float32],
    maps_taps: tuple[NDArray[np.int32], NDArray[np.float32]],
    painted: NDArray[np.float32],
    painted_taps: tuple[NDArray[np.int32], NDArray[np.float32]],
    fade_rows: NDArray[np.float32],
    fade_columns: NDArray[np.float32],
    window: tuple[int, int],
    out: NDArray[np.uint8],
) -> None:
    """Draw a part of the square: the photo where the occlusion shows it, the painting elsewhere.

    Args:
        photo: (H, W, 3) uint8.
        origin: pixel (x, y) of the photo at which the square begins.
        maps: (h, 3 * w) float32: shift (x, y) in pixels of the photo and occlusion in [0, 1].
        maps_taps: four places and weights in `maps` for every row (and column) of the square,
            (S, 4) each.
        painted: (g, 3 * g) float32 in [0, 255].
        painted_taps: as `maps_taps`, of `painted`.
        fade_rows: (S,) in [0, 1]; multiplies the shifts and the share of the painting.
        fade_columns: (S,), as `fade_rows`.
        window: pixel (x, y) of the square at which `out` begins.
        out: (a, b, 3) uint8, written.
    """
    map_line = np.empty(maps.shape[1], np.float32)
    painted_line = np.empty(painted.shape[1], np.float32)
    one, half, most = np.float32(1.0), np.float32(0.5), np.float32(255.0)
    for j in range(out.shape[0]):
        row = window[1] + j
        _row(maps, maps_taps[0][row], maps_taps[1][row], map_line)
        _row(painted, painted_taps[0][row], painted_taps[1][row], painted_line)
        for i in range(out.shape[1]):
            column = window[0] + i
            dx, dy, shown = _between(map_line, maps_taps[0][column], maps_taps[1][column])
            fade = fade_rows[row] * fade_columns[column]
            dx, dy = dx * fade, dy * fade
            shown = one - (one - min(max(shown, np.float32(0.0)), one)) * fade
            x, y = origin[0] + column, origin[1] + row
            if abs(dx) < STILL and abs(dy) < STILL:
                x, y = min(max(x, 0), photo.shape[1] - 1), min(max(y, 0), photo.shape[0] - 1)
                red, green, blue = (
                    np.float32(photo[y, x, 0]), np.float32(photo[y, x, 1]),
                    np.float32(photo[y, x, 2]),
                )  # fmt: skip
            else:
                red, green, blue = _sample(photo, np.float32(x) + dx, np.float32(y) + dy)
            if shown < SHOWN:
                r, g, b = _between(painted_line, painted_taps[0][column], painted_taps[1][column])
                red += (r - red) * (one - shown)
                green += (g - green) * (one - shown)
                blue += (b - blue) * (one - shown)
            out[j, i, 0] = np.uint8(min(max(red, np.float32(0.0)), most) + half)
            out[j, i, 1] = np.uint8(min(max(green, np.float32(0.0)), most) + half)
            out[j, i, 2] = np.uint8(min(max(blue, np.float32(0.0)), most) + half)
