"""Frames at the photo's own resolution: flow and occlusion of small frames, pixels of the photo.

The networks work on a small square (256 pixels). Their flow is smooth, so it can be applied to
the photo at any size: `warp(photo) * occlusion + painted * (1 - occlusion)`, the last step of
MRAA's generator, with the photo's own pixels and the painted picture enlarged.

Where that step at 256 pixels reads zeros outside of the square, the photo itself goes on here,
and beyond the photo its edges do. Flow is applied as a shift from rest, so that a flow at rest
gives the photo itself in both grid conventions (with `align_corners=False` the reference code's
flow at rest enlarges by 1/63).

The photo warped and blended at a size of its own, as one compiled loop over pixels.
"""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from data_prep.speaker.crop import Crop, cut_out
from mraa.fast import enabled
from mraa.fast.compiled import compiled
from mraa.grid import coordinate_grid, resize_flow

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


def draw_plain(
    photo: NDArray[np.uint8], origin: tuple[int, int], maps: NDArray[np.float32], maps_taps: "Taps",
    painted: NDArray[np.float32], painted_taps: "Taps", fade_rows: NDArray[np.float32],
    fade_columns: NDArray[np.float32], window: tuple[int, int], out: NDArray[np.uint8],
) -> None:  # fmt: skip
    """What `draw` does, by NumPy alone; a shift or occlusion too small to be seen counts too."""
    height, width = photo.shape[:2]
    rows, columns = (slice(a, a + n) for a, n in zip(window[::-1], out.shape[:2], strict=True))

    def resized(image: NDArray[np.float32], places: "Taps") -> NDArray[np.float32]:
        image = image.reshape(len(image), -1, 3)
        place, weight = (part[rows] for part in places)
        image = np.einsum("ik,ikwc->iwc", weight, image[place])
        place, weight = (part[columns] for part in places)
        return np.einsum("jk,ijkc->ijc", weight, image[:, place])

    fade = (fade_rows[rows, None] * fade_columns[columns])[..., None]
    shift, shown = np.split(resized(maps, maps_taps), [2], axis=2)
    shown = 1 - (1 - shown.clip(0, 1)) * fade
    shift *= fade
    x = origin[0] + np.arange(columns.start, columns.stop) + shift[..., 0]
    y = origin[1] + np.arange(rows.start, rows.stop)[:, None] + shift[..., 1]
    x, y = x.clip(-4, width + 3), y.clip(-4, height + 3)
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    across, down = _cubic(x - left), _cubic(y - top)
    colour = np.zeros(out.shape, np.float64)
    for j in range(4):
        row = (top + j - 1).clip(0, height - 1)
        for i in range(4):
            column = (left + i - 1).clip(0, width - 1)
            colour += (down[j] * across[i])[..., None] * photo[row, column]
    colour += (resized(painted, painted_taps) - colour) * (1 - shown)
    out[:] = (colour.clip(0, 255) + 0.5).astype(np.uint8)


MARGIN = 1 / 8
"""Of the side: how much of the photo around the square is kept for what moves in from there."""


FADE = 1 / 10
"""Of the side: over which motion grows from none at a border to all of it."""


Taps = tuple[NDArray[np.int32], NDArray[np.float32]]


def taps(positions: NDArray[np.float64], count: int) -> Taps:
    """Catmull-Rom interpolation between `count` samples at `positions` (n,).

    Returns:
        places (n, 4) of the samples, the first and last repeated beyond the ends, and their
        weights (n, 4), which sum to 1.
    """
    held = np.clip(positions, 0, count - 1)
    first = np.minimum(np.floor(held), max(count - 2, 0))
    t = held - first
    weights = np.stack(
        [
            -0.5 * t * (1 - t) ** 2,
            1 - t * t * (2.5 - 1.5 * t),
            0.5 * t * (1 + t * (4 - 3 * t)),
            -0.5 * t * t * (1 - t),
        ],
        axis=1,
    )
    places = np.clip(first[:, None] + np.arange(-1, 3), 0, count - 1)
    return places.astype(np.int32), weights.astype(np.float32)


@lru_cache(maxsize=8)
def _painted_taps(size: int, count: int) -> Taps:
    """Where pixels of the square lie among `count` pixels of the same square."""
    return taps((np.arange(size) + 0.5) * count / size - 0.5, count)


@lru_cache(maxsize=8)
def _map_taps(size: int, painted: int, count: int, align_corners: bool) -> Taps:
    """Where pixels of the square lie among `count` of the flow, whose grid is of `painted`."""
    small = (np.arange(size) + 0.5) * painted / size - 0.5
    if align_corners:
        return taps(small * (count - 1) / (painted - 1), count)
    return taps((small + 0.5) * count / painted - 0.5, count)


def border_fade(size: int, start: bool, end: bool) -> NDArray[np.float32]:
    """Weights (size,) that rise smoothly from 0 at the first and last pixel where asked, else 1."""
    reach = max(2.0, FADE * size)
    at = np.arange(size)
    never = np.full(size, size)
    inner = np.minimum(at if start else never, at[::-1] if end else never)
    t = np.clip(inner / reach, 0, 1)
    return (t * t * (3 - 2 * t)).astype(np.float32)


@dataclass(frozen=True)
class Ground:
    """The photo around a square, at the square's resolution."""

    photo: NDArray[np.uint8]
    """(H, W, 3) RGB."""
    origin: tuple[int, int]
    """Pixel (x, y) at which the square begins; it may lie outside."""


def ground(photo: NDArray[np.uint8], crop: Crop, size: int) -> Ground:
    """The photo (H, W, 3) scaled so that the square has `size` pixels a side, and what is near."""
    if size == crop.size:
        return Ground(np.ascontiguousarray(photo), (crop.x, crop.y))
    margin = round(MARGIN * size)
    wide = round(MARGIN * crop.size)
    around = Crop(crop.x - wide, crop.y - wide, crop.size + 2 * wide)
    image = cut_out(photo, around, size + 2 * margin)
    image[margin:-margin, margin:-margin] = cut_out(photo, crop, size)
    return Ground(image, (margin, margin))


class FullSize:
    """A square of a photo, drawn at any size from flow, occlusion and painted pictures.

    Args:
        photo: (H, W, 3) uint8 RGB.
        crop: the square that the networks see, as `cut_out` gives it to them.
        size: S, pixels of the square's side in the frames.
        align_corners: grid convention of the renderer.
        whole: frames are the whole photo with the square in its place, which needs S to be the
            side of `crop`; motion fades towards the borders of the square inside the photo.

    Raises:
        ValueError: `whole` with another size.
    """

    def __init__(
        self,
        photo: NDArray[np.uint8],
        crop: Crop,
        size: int,
        *,
        align_corners: bool = True,
        whole: bool = False,
    ) -> None:
        if whole and size != crop.size:
            raise ValueError(f"the square of the whole photo has {crop.size} pixels, not {size}")
        height, width = photo.shape[:2]
        self.size, self.align_corners = size, align_corners
        self.whole = photo if whole else None
        self.ground = ground(photo, crop, size)
        left, right = crop.x > 0, crop.x + crop.size < width
        top, bottom = crop.y > 0, crop.y + crop.size < height
        self.fade_columns = border_fade(size, whole and left, whole and right)
        self.fade_rows = border_fade(size, whole and top, whole and bottom)
        self.columns, self.rows = slice(0, size), slice(0, size)
        if whole:  # what lies outside of the photo is not drawn
            self.columns = slice(max(-crop.x, 0), min(size, width - crop.x))
            self.rows = slice(max(-crop.y, 0), min(size, height - crop.y))
        self.pool = ThreadPoolExecutor(torch.get_num_threads())

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the frames."""
        return (self.size, self.size) if self.whole is None else self.whole.shape[:2]

    def frames(self, flow: Tensor, occlusion: Tensor, painted: Tensor) -> NDArray[np.uint8]:
        """Draw frames.

        Args:
            flow: (b, h, w, 2) source coordinates (x, y) in [-1, 1], h = w.
            occlusion: (b, 1, h', w') in [0, 1], h' = w'; 1 where the source shows what is needed.
            painted: (b, 3, g, g) in [0, 1], the generated pictures before the last blend.

        Returns:
            (b, S, S, 3) uint8 RGB, or (b, H, W, 3) of the whole photo.
        """
        count, side = len(flow), painted.shape[-1]
        grid = coordinate_grid(flow.shape[1], flow.shape[2], flow.device)
        shift = (flow - grid) * ((side - 1) / 2 * self.size / side)  # in pixels of the square
        if shift.shape[1:3] != occlusion.shape[2:]:
            fine = occlusion.shape[2:]
            shift = resize_flow(shift, *fine, align_corners=self.align_corners)
        maps = torch.cat([shift, occlusion[:, 0, ..., None]], dim=-1).float()
        colours = painted.float()
        if self.size < side:  # taps between four pixels would alias
            size = (self.size, self.size)
            colours = F.interpolate(colours, size, mode="bicubic", antialias=True)
        colours = (colours * 255).permute(0, 2, 3, 1)
        small = maps.flatten(2).contiguous().cpu().numpy()  # (b, h, 3 w)
        large = colours.flatten(2).contiguous().cpu().numpy()  # (b, g, 3 g)
        map_taps = _map_taps(self.size, side, maps.shape[1], self.align_corners)
        out = np.empty((count, *self.shape, 3), np.uint8)

        def one(n: int) -> None:
            self._draw(small[n], map_taps, large[n], out[n])

        list(self.pool.map(one, range(count)))
        return out

    def _draw(
        self,
        maps: NDArray[np.float32],
        map_taps: Taps,
        painted: NDArray[np.float32],
        out: NDArray[np.uint8],
    ) -> None:
        view = out
        if self.whole is not None:
            out[:] = self.whole
            x, y = self.ground.origin
            view = out[
                y + self.rows.start : y + self.rows.stop,
                x + self.columns.start : x + self.columns.stop,
            ]
        (draw if enabled() else draw_plain)(
            self.ground.photo,
            self.ground.origin,
            maps,
            map_taps,
            painted,
            _painted_taps(self.size, len(painted)),
            self.fade_rows,
            self.fade_columns,
            (self.columns.start, self.rows.start),
            view,
        )
