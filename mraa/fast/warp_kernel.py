"""The renderer's memory-bound steps as compiled loops over pixels, channels last.

Each does in one pass over memory what takes several in `mraa.flow` and `mraa.generator`: what
the flow predictor sees, the flow from its logits, the warp of the source's features with the
blend by the occlusion, the last picture. Coordinates, exponentials and sums are float32.

Arrays are C-contiguous with channels last. Activations are float32, or bfloat16 given by its bits
as uint16. Nothing here takes a lock: call from as many threads as there are batches. Arrays are not
assigned to parts of others: numba compiles three seconds for what that may say of their shapes.
"""

import math
from typing import Any

import numpy as np
from numba import types
from numba.extending import overload

from mraa.fast.compiled import compiled

NONE, SAME, PHASES = 0, 1, 2
"""How generated features lie: not there; pixel by pixel; four phases of doubled pixels.

PHASES are `(b, h + 1, w + 1, 4 C)`, or more places that mean nothing: pixel (2 y + i, 2 x + j) is
phase 2 i + j of place (y + i, x + j), as a 2x2 convolution with one pixel of padding leaves them.
"""


def _load(value: Any) -> Any:
    """float32 of an activation, which is one or the bits of a bfloat16."""
    return value


def _like(value: Any, array: Any) -> Any:
    """A float32 as an activation of the type of `array`."""
    return value


@overload(_load, strict=False)
def _load_compiled(value: Any) -> Any:
    if value == types.uint16:
        return lambda value: np.uint32(np.uint32(value) << np.uint32(16)).view(np.float32)
    return lambda value: value


@overload(_like, strict=False)
def _like_compiled(value: Any, array: Any) -> Any:
    if array.dtype != types.uint16:
        return lambda value, array: value
    return lambda value, array: np.uint16(  # to the nearest, away from zero on a tie
        np.uint32(np.float32(value).view(np.uint32) + np.uint32(0x8000)) >> np.uint32(16)
    )


@compiled
def _exp(x: float) -> float:
    """Exponential of a float32, to about one unit in the last place; 0 below -87."""
    x = min(max(x, np.float32(-87.0)), np.float32(88.0))
    n = np.float32(math.floor(x * np.float32(1.44269504) + np.float32(0.5)))
    r = x - n * np.float32(0.693359375) + n * np.float32(2.12194440e-4)
    p = np.float32(1.9875691500e-4)
    p = p * r + np.float32(1.3981999507e-3)
    p = p * r + np.float32(8.3334519073e-3)
    p = p * r + np.float32(4.1665795894e-2)
    p = p * r + np.float32(1.6666665459e-1)
    p = p * r + np.float32(5.0000001201e-1)
    p = p * r * r + r + np.float32(1.0)
    return p * np.int32((np.int32(n) + np.int32(127)) << np.int32(23)).view(np.float32)


@compiled
def _pixel(coordinate: float, size: int, corners: bool) -> float:
    """Pixel of a coordinate in [-1, 1], as grid_sample counts."""
    half = np.float32(0.5)
    if corners:
        return (coordinate + np.float32(1.0)) * half * np.float32(size - 1)
    return ((coordinate + np.float32(1.0)) * np.float32(size) - np.float32(1.0)) * half


@compiled
def _between(i: int, size: int, small: int, corners: bool) -> tuple[int, int, float]:
    """Where pixel `i` of `size` lies among `small` pixels, as interpolate counts."""
    if corners:
        step = np.float32(small - 1) / np.float32(size - 1) if size > 1 else np.float32(0.0)
        x = np.float32(i) * step
    else:
        step = np.float32(small) / np.float32(size)
        x = max((np.float32(i) + np.float32(0.5)) * step - np.float32(0.5), np.float32(0.0))
    low = min(np.int64(x), small - 1)
    return np.uintp(low), np.uintp(min(low + 1, small - 1)), x - np.float32(low)


@compiled
def _row_flow(
    flow: np.ndarray, occlusion: np.ndarray, n: int, j: int, height: int, corners: bool,
    across: np.ndarray, down: np.ndarray, shown: np.ndarray,
) -> None:  # fmt: skip
    """Row `j` of `height` of frame n's flow and occlusion, resized: x, y and occlusion (W,)."""
    one, width = np.float32(1.0), len(across)
    y0, y1, v = _between(j, height, flow.shape[1], corners)
    for i in range(width):
        x0, x1, u = _between(i, width, flow.shape[2], corners)
        a, b, c, d = (one - v) * (one - u), (one - v) * u, v * (one - u), v * u
        x = a * flow[n, y0, x0, 0] + b * flow[n, y0, x1, 0]
        y = a * flow[n, y0, x0, 1] + b * flow[n, y0, x1, 1]
        o = a * occlusion[n, y0, x0] + b * occlusion[n, y0, x1]
        across[i] = x + c * flow[n, y1, x0, 0] + d * flow[n, y1, x1, 0]
        down[i] = y + c * flow[n, y1, x0, 1] + d * flow[n, y1, x1, 1]
        shown[i] = o + c * occlusion[n, y1, x0] + d * occlusion[n, y1, x1]


@compiled
def _far(matrix: np.ndarray, n: int, x: float, y: float) -> tuple[float, float]:
    """A point (x, y) moved by homography `n` of (b, 3, 3)."""
    depth = matrix[n, 2, 0] * x + matrix[n, 2, 1] * y + matrix[n, 2, 2]
    across = matrix[n, 0, 0] * x + matrix[n, 0, 1] * y + matrix[n, 0, 2]
    down = matrix[n, 1, 0] * x + matrix[n, 1, 1] * y + matrix[n, 1, 2]
    return across / depth, down / depth


@compiled
def _row_taps(
    across: np.ndarray, down: np.ndarray, height: int, width: int, corners: bool,
    place: np.ndarray, u: np.ndarray, v: np.ndarray,
) -> None:  # fmt: skip
    """Where coordinates (x, y) fall in a picture that `framed` gave.

    Args:
        across: (n,) float32 x in [-1, 1].
        down: (n,) float32 y in [-1, 1].
        height: of the picture without its frame.
        width: of the picture without its frame.
        corners: whether -1 and 1 are centres of the corner pixels.
        place: (n,) int32, written: number of the upper left one of four pixels.
        u: (n,) float32, written: part of the way to the right ones.
        v: (n,) float32, written: part of the way to the lower ones.
    """
    wide = np.int32(width + 3)
    most = np.int32((height + 2) * (width + 3) - 2)
    for i in range(len(place)):
        x = _pixel(across[i], width, corners) + np.float32(1.0)
        y = _pixel(down[i], height, corners) + np.float32(1.0)
        x = min(max(x, np.float32(0.0)), np.float32(width + 1))  # far outside is outside
        y = min(max(y, np.float32(0.0)), np.float32(height + 1))
        left, top = np.int32(x), np.int32(y)
        u[i], v[i] = x - np.float32(left), y - np.float32(top)
        place[i] = min(max(np.int32(top * wide + left), np.int32(0)), most)  # even for a NaN


@compiled
def _row_sample(
    picture: np.ndarray, plane: int, wide: int, place: np.ndarray, u: np.ndarray, v: np.ndarray,
    out: np.ndarray,
) -> None:  # fmt: skip
    """One colour of the planes of a picture, rows of `wide`, at what `_row_taps` gave."""
    for i in range(len(place)):
        a, b = picture[plane, np.uint32(place[i])], picture[plane, np.uint32(place[i] + 1)]
        c = picture[plane, np.uint32(place[i] + wide)]
        d = picture[plane, np.uint32(place[i] + wide + 1)]
        upper, lower = a + u[i] * (b - a), c + u[i] * (d - c)
        out[plane, i] = upper + v[i] * (lower - upper)


@compiled
def gaussians(shift: np.ndarray, precision: np.ndarray, out: np.ndarray) -> None:
    """Heatmaps of regions, `exp(-0.5 (z - mu)^T P (z - mu))`.

    Args:
        shift: (K, 2) float32 centres.
        precision: (K, 3) float32, entries xx, xy, yy of the inverse covariance.
        out: (h, K, w) float32, written.
    """
    height, regions, width = out.shape
    for j in range(height):
        y = np.float32(2 * j) / np.float32(height - 1) - np.float32(1.0)
        for k in range(regions):
            dy = y - shift[k, 1]
            xx, xy, yy = precision[k, 0], precision[k, 1], precision[k, 2]
            for i in range(width):
                dx = np.float32(2 * i) / np.float32(width - 1) - np.float32(1.0) - shift[k, 0]
                form = xx * dx * dx + np.float32(2.0) * xy * dx * dy + yy * dy * dy
                out[j, k, i] = _exp(np.float32(-0.5) * form)


@compiled
def flow_input(
    small: np.ndarray, still: np.ndarray, shift: np.ndarray, precision: np.ndarray,
    maps: np.ndarray, background: np.ndarray, corners: bool, out: np.ndarray,
) -> None:  # fmt: skip
    """What the flow predictor sees: for every region heatmap difference and deformed source.

    Args:
        small: `mraa.fast.flow.planes` of the small source (h, w, 3).
        still: (h, K, w) float32, `gaussians` of the source.
        shift: (b, K, 2) float32 of the driving regions.
        precision: (b, K, 3) float32 of the driving regions.
        maps: (b, K, 6) float32, rows (m00, m01, t0, m10, m11, t1) from driving to source.
        background: (b, 3, 3) float32 homographies.
        corners: whether -1 and 1 are centres of the corner pixels.
        out: (b, h, w, 4 (K + 1)), written; the background comes first.
    """
    height, regions, width = still.shape
    moving = np.empty(still.shape, np.float32)
    across, down, u, v = np.empty((4, width), np.float32)
    colour, place = np.empty((3, width), np.float32), np.empty(width, np.int32)
    wide = np.int32(width + 3)
    for n in range(len(shift)):
        gaussians(shift[n], precision[n], moving)
        for j in range(height):
            y = np.float32(2 * j) / np.float32(height - 1) - np.float32(1.0)
            for k in range(regions + 1):
                for i in range(width):
                    x = np.float32(2 * i) / np.float32(width - 1) - np.float32(1.0)
                    if k == 0:
                        across[i], down[i] = _far(background, n, x, y)
                        out[n, j, i, 0] = _like(np.float32(0.0), out)
                    else:
                        m = k - 1
                        across[i] = maps[n, m, 0] * x + maps[n, m, 1] * y + maps[n, m, 2]
                        down[i] = maps[n, m, 3] * x + maps[n, m, 4] * y + maps[n, m, 5]
                        out[n, j, i, 4 * k] = _like(moving[j, m, i] - still[j, m, i], out)
                _row_taps(across, down, height, width, corners, place, u, v)
                for e in range(3):
                    _row_sample(small, e, wide, place, u, v, colour)
                for i in range(width):
                    for e in range(3):
                        out[n, j, i, 4 * k + 1 + e] = _like(colour[e, i], out)


@compiled
def flow_result(
    logits: np.ndarray, maps: np.ndarray, background: np.ndarray,
    flow: np.ndarray, occlusion: np.ndarray,
) -> None:  # fmt: skip
    """Flow and occlusion from the flow predictor's logits: softmax, blend of the motions, sigmoid.

    Args:
        logits: (b, h, w, n (K + 2)), of the masks (background first) and of the occlusion, in n
            parts: pixel x is the sum over j of part j of pixel x + j - n // 2.
        maps: as in `flow_input`.
        background: as in `flow_input`.
        flow: (b, h, w, 2) float32, written.
        occlusion: (b, h, w) float32, written.
    """
    count, height, width = logits.shape[:3]
    channels = maps.shape[1] + 2
    parts = logits.shape[3] // channels
    value = np.empty(channels, np.float32)
    one = np.float32(1.0)
    for n in range(count):
        for j in range(height):
            y = np.float32(2 * j) / np.float32(height - 1) - one
            for i in range(width):
                x = np.float32(2 * i) / np.float32(width - 1) - one
                value[:] = 0.0
                for part in range(parts):
                    at = i + part - parts // 2
                    if 0 <= at < width:
                        for k in range(channels):
                            value[k] += _load(logits[n, j, at, part * channels + k])
                highest = value[0]
                for k in range(1, channels - 1):
                    highest = max(highest, value[k])
                for k in range(channels - 1):
                    value[k] = _exp(value[k] - highest)
                far, low = _far(background, n, x, y)
                across, down, total = value[0] * far, value[0] * low, value[0]
                for k in range(channels - 2):
                    share = value[k + 1]
                    across += share * (maps[n, k, 0] * x + maps[n, k, 1] * y + maps[n, k, 2])
                    down += share * (maps[n, k, 3] * x + maps[n, k, 4] * y + maps[n, k, 5])
                    total += share
                flow[n, j, i, 0], flow[n, j, i, 1] = across / total, down / total
                occlusion[n, j, i] = one / (one + _exp(-value[channels - 1]))


@compiled
def blend(
    features: np.ndarray, flow: np.ndarray, occlusion: np.ndarray, corners: bool,
    generated: np.ndarray, lie: int, warped: bool, out: np.ndarray,
) -> None:  # fmt: skip
    """Source features warped by the flow where the source shows them, generated ones elsewhere.

    Args:
        features: (pixels, C), those of the source (H, W, C), `mraa.fast.flow.framed`.
        flow: (b, h, w, 2) float32 source coordinates; resized to (H, W) bilinearly.
        occlusion: (b, h, w) float32, 1 where the source shows what is needed.
        corners: grid convention of warp and resize.
        generated: features as `lie` tells, of the dtype of `out`.
        lie: NONE, SAME or PHASES.
        warped: False leaves the source out: `out` is what was generated, pixel by pixel.
        out: (b, H, W, C), written: `warped * occlusion + generated * (1 - occlusion)`.
    """
    _, height, width, channels = out.shape
    one, wide = np.float32(1.0), np.int32(width + 3)
    across, down, shown, u, v = np.zeros((5, width), np.float32)
    place = np.zeros(width, np.int32)
    for n in range(len(out)):
        for j in range(height):
            if warped:
                _row_flow(flow, occlusion, n, j, height, corners, across, down, shown)
                _row_taps(across, down, height, width, corners, place, u, v)
            for i in range(width):
                first, below = np.uintp(place[i]), np.uintp(place[i] + wide)
                right, last = np.uintp(place[i] + 1), np.uintp(place[i] + wide + 1)
                upper, lower = (one - v[i]) * shown[i], v[i] * shown[i]
                a, b = upper * (one - u[i]), upper * u[i]
                c, d = lower * (one - u[i]), lower * u[i]
                hidden, row, column, beside = one - shown[i], j, i, 0
                if lie == PHASES:
                    beside = (2 * (j % 2) + i % 2) * channels
                    row, column = j // 2 + j % 2, i // 2 + i % 2
                for e in range(channels):
                    value = a * _load(features[first, e]) + b * _load(features[right, e])
                    value += c * _load(features[below, e]) + d * _load(features[last, e])
                    if lie != NONE:
                        value += hidden * _load(generated[n, row, column, beside + e])
                    out[n, j, i, e] = _like(value, out)


@compiled
def join(phases: np.ndarray, skip: np.ndarray, out: np.ndarray) -> None:
    """Phases put in their places, with a skip behind them.

    Args:
        phases: (b, h + 1, w + 1, 4 C) or larger.
        skip: (b, 2 h, 2 w, S).
        out: (b, 2 h, 2 w, C + S), written.
    """
    count, height, width, beside = skip.shape
    channels = out.shape[3] - beside
    for n in range(count):
        for j in range(height):
            for i in range(width):
                p, q = j % 2, i % 2
                row, column, first = j // 2 + p, i // 2 + q, (2 * p + q) * channels
                for e in range(channels):
                    out[n, j, i, e] = phases[n, row, column, first + e]
                for e in range(beside):
                    out[n, j, i, channels + e] = skip[n, j, i, e]


@compiled
def _row_logits(logits: np.ndarray, n: int, j: int, channel: int, line: np.ndarray) -> None:
    """Row `j` of a channel of frame n, as a pixel shuffle by 2 reads it: (W,)."""
    first = 4 * channel + 2 * (j % 2)
    for i in range(len(line) // 2):
        line[2 * i] = _load(logits[n, j // 2, i, first])
        line[2 * i + 1] = _load(logits[n, j // 2, i, first + 1])


@compiled
def picture(
    photo: np.ndarray, flow: np.ndarray, occlusion: np.ndarray, corners: bool,
    logits: np.ndarray, warped: bool, painted: np.ndarray, fine: np.ndarray, out: np.ndarray,
) -> None:  # fmt: skip
    """The frames: sigmoid of the generator's logits, blended with the warped photo.

    Args:
        photo: `mraa.fast.flow.planes` of the photo (H, W, 3) in [0, 1].
        flow: as in `blend`.
        occlusion: as in `blend`.
        corners: as in `blend`.
        logits: (b, H / 2, W / 2, 12) for a pixel shuffle by 2; 16 with a fine occlusion's.
        warped: False leaves the photo out.
        painted: (b, 3, H, W) float32, written: the generated picture; or of size 0.
        fine: (b, H, W) float32, written: the occlusion so moved; or of size 0.
        out: (b, H, W, 3) uint8, written.
    """
    height, width = out.shape[1:3]
    one, wide = np.float32(1.0), np.int32(width + 3)
    made, seen = np.empty((3, width), np.float32), np.zeros((3, width), np.float32)
    line, across, down, shown, u, v = np.zeros((6, width), np.float32)
    place = np.empty(width, np.int32)
    for n in range(len(out)):
        for j in range(height):
            if warped:
                _row_flow(flow, occlusion, n, j, height, corners, across, down, shown)
                _row_taps(across, down, height, width, corners, place, u, v)
            if logits.shape[3] > 12:
                _row_logits(logits, n, j, 3, line)
                for i in range(width):
                    shown[i] /= shown[i] + (one - shown[i]) * _exp(-line[i])
                if fine.size:
                    for i in range(width):
                        fine[n, j, i] = shown[i]
            for e in range(3):
                _row_logits(logits, n, j, e, line)
                for i in range(width):
                    made[e, i] = one / (one + _exp(-line[i]))
                if warped:
                    _row_sample(photo, e, wide, place, u, v, seen)
                for i in range(width):
                    value = seen[e, i] * shown[i] + made[e, i] * (one - shown[i])
                    value = min(max(value, np.float32(0.0)), one)
                    out[n, j, i, e] = np.uint8(value * np.float32(255.0) + np.float32(0.5))
            if painted.size:
                for e in range(3):
                    for i in range(width):
                        painted[n, e, j, i] = made[e, i]
