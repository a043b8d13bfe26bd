"""The renderer's memory-bound steps as compiled loops over pixels, channels last.

Each does in one pass over memory what takes several in `mraa.flow` and `mraa.generator`: what
the flow predictor sees, the flow from its logits, the warp of the source's features with the
blend by the occlusion, the last picture. Coordinates, exponentials and sums are float32.

Arrays are C-contiguous with channels last. Activations are float32, or bfloat16 given by its bits
as uint16. Nothing here takes a lock: call from as many threads as there are batches.
"""

import math
from typing import Any

import numpy as np
from numba import njit, types
from numba.extending import overload

NONE, SAME, PHASES = 0, 1, 2
"""How generated features lie: not there; pixel by pixel; four phases of doubled pixels.

PHASES are `(b, h + 1, w + 1, 4 C)`: pixel (2 y + i, 2 x + j) is phase 2 i + j of place
(y + i, x + j), as a 2x2 convolution with one pixel of padding leaves them.
"""

_compiled: Any = njit(nogil=True, cache=True, error_model="numpy")


def _load(value: Any) -> Any:
    raise NotImplementedError("exists compiled only")


def _store(out: Any, place: Any, value: Any) -> Any:
    raise NotImplementedError("exists compiled only")


@overload(_load, inline="always")
def _load_typed(value: Any) -> Any:
    """float32 of a float32, or of the bits of a bfloat16."""
    if value == types.uint16:

        def widened(value: Any) -> Any:
            return np.uint32(np.uint32(value) << np.uint32(16)).view(np.float32)

        return widened

    def plain(value: Any) -> Any:
        return value

    return plain


@overload(_store, inline="always")
def _store_typed(out: Any, place: Any, value: Any) -> Any:
    """Write a float32, or the bits of the nearest bfloat16, even on a tie."""
    if out.dtype == types.uint16:

        def rounded(out: Any, place: Any, value: Any) -> Any:
            bits = np.float32(value).view(np.uint32)
            odd = np.uint32(bits >> np.uint32(16)) & np.uint32(1)
            out[place] = np.uint16(np.uint32(bits + np.uint32(0x7FFF) + odd) >> np.uint32(16))

        return rounded

    def plain(out: Any, place: Any, value: Any) -> Any:
        out[place] = value

    return plain


@_compiled
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


@_compiled
def _pixel(coordinate: float, size: int, corners: bool) -> float:
    """Pixel of a coordinate in [-1, 1], as grid_sample counts."""
    half = np.float32(0.5)
    if corners:
        return (coordinate + np.float32(1.0)) * half * np.float32(size - 1)
    return ((coordinate + np.float32(1.0)) * np.float32(size) - np.float32(1.0)) * half


@_compiled
def _taps(x: float, size: int) -> tuple[int, int, float, float]:
    """Two neighbouring pixels inside the picture and their weights; 0 for one outside."""
    x = min(max(x, np.float32(-2.0)), np.float32(size + 1))  # far outside is outside
    low = math.floor(x)
    part = x - np.float32(low)
    first, last = np.int64(low), np.int64(low) + 1
    weight0 = np.float32(1.0) - part if 0 <= first < size else np.float32(0.0)
    weight1 = part if 0 <= last < size else np.float32(0.0)
    return min(max(first, 0), size - 1), min(max(last, 0), size - 1), weight0, weight1


@_compiled
def _between(i: int, size: int, small: int, corners: bool) -> tuple[int, int, float]:
    """Where pixel `i` of `size` lies among `small` pixels, as interpolate counts."""
    if corners:
        step = np.float32(small - 1) / np.float32(size - 1) if size > 1 else np.float32(0.0)
        x = np.float32(i) * step
    else:
        step = np.float32(small) / np.float32(size)
        x = max((np.float32(i) + np.float32(0.5)) * step - np.float32(0.5), np.float32(0.0))
    low = min(np.int64(x), small - 1)
    return low, min(low + 1, small - 1), x - np.float32(low)


@_compiled
def _flow_at(
    flow: np.ndarray,
    occlusion: np.ndarray,
    rows: tuple[int, int, float],
    columns: tuple[int, int, float],
) -> tuple[float, float, float]:
    """Flow (x, y) and occlusion between four pixels."""
    y0, y1, v = rows
    x0, x1, u = columns
    one = np.float32(1.0)
    a, b, c, d = (one - v) * (one - u), (one - v) * u, v * (one - u), v * u
    x = a * flow[y0, x0, 0] + b * flow[y0, x1, 0] + c * flow[y1, x0, 0] + d * flow[y1, x1, 0]
    y = a * flow[y0, x0, 1] + b * flow[y0, x1, 1] + c * flow[y1, x0, 1] + d * flow[y1, x1, 1]
    o = a * occlusion[y0, x0] + b * occlusion[y0, x1]
    return x, y, o + c * occlusion[y1, x0] + d * occlusion[y1, x1]


@_compiled
def _far(matrix: np.ndarray, x: float, y: float) -> tuple[float, float]:
    """A point (x, y) moved by a homography (3, 3)."""
    depth = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2]
    across = matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2]
    down = matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2]
    return across / depth, down / depth


@_compiled
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


@_compiled
def flow_input(
    small: np.ndarray,
    still: np.ndarray,
    shift: np.ndarray,
    precision: np.ndarray,
    maps: np.ndarray,
    background: np.ndarray,
    corners: bool,
    out: np.ndarray,
) -> None:
    """What the flow predictor sees: for every region heatmap difference and deformed source.

    Args:
        small: (h, w, 3) float32, the small source.
        still: (h, K, w) float32, `gaussians` of the source.
        shift: (b, K, 2) float32 of the driving regions.
        precision: (b, K, 3) float32 of the driving regions.
        maps: (b, K, 6) float32, rows (m00, m01, t0, m10, m11, t1) from driving to source.
        background: (b, 3, 3) float32 homographies.
        corners: whether -1 and 1 are centres of the corner pixels.
        out: (b, h, w, 4 (K + 1)), written; the background comes first.
    """
    height, width = small.shape[:2]
    regions = shift.shape[1]
    moving = np.empty(still.shape, np.float32)
    for n in range(len(shift)):
        gaussians(shift[n], precision[n], moving)
        for j in range(height):
            y = np.float32(2 * j) / np.float32(height - 1) - np.float32(1.0)
            for i in range(width):
                x = np.float32(2 * i) / np.float32(width - 1) - np.float32(1.0)
                line = out[n, j, i]
                for k in range(regions + 1):
                    if k == 0:
                        across, down = _far(background[n], x, y)
                        _store(line, 0, np.float32(0.0))
                    else:
                        m = maps[n, k - 1]
                        across, down = m[0] * x + m[1] * y + m[2], m[3] * x + m[4] * y + m[5]
                        _store(line, 4 * k, moving[j, k - 1, i] - still[j, k - 1, i])
                    x0, x1, u0, u1 = _taps(_pixel(across, width, corners), width)
                    y0, y1, v0, v1 = _taps(_pixel(down, height, corners), height)
                    a, b, c, d = v0 * u0, v0 * u1, v1 * u0, v1 * u1
                    for e in range(3):
                        value = a * small[y0, x0, e] + b * small[y0, x1, e]
                        value += c * small[y1, x0, e] + d * small[y1, x1, e]
                        _store(line, 4 * k + 1 + e, value)


@_compiled
def flow_result(
    logits: np.ndarray,
    maps: np.ndarray,
    background: np.ndarray,
    flow: np.ndarray,
    occlusion: np.ndarray,
) -> None:
    """Flow and occlusion from the flow predictor's logits: softmax, blend of the motions, sigmoid.

    Args:
        logits: (b, h, w, K + 2), of the masks (background first) and of the occlusion.
        maps: as in `flow_input`.
        background: as in `flow_input`.
        flow: (b, h, w, 2) float32, written.
        occlusion: (b, h, w) float32, written.
    """
    count, height, width, channels = logits.shape
    weight = np.empty(channels - 1, np.float32)
    for n in range(count):
        for j in range(height):
            y = np.float32(2 * j) / np.float32(height - 1) - np.float32(1.0)
            for i in range(width):
                x = np.float32(2 * i) / np.float32(width - 1) - np.float32(1.0)
                line = logits[n, j, i]
                highest = _load(line[0])
                for k in range(1, channels - 1):
                    highest = max(highest, _load(line[k]))
                for k in range(channels - 1):
                    weight[k] = _exp(_load(line[k]) - highest)
                far, low = _far(background[n], x, y)
                across, down, total = weight[0] * far, weight[0] * low, weight[0]
                for k in range(channels - 2):
                    m, part = maps[n, k], weight[k + 1]
                    across += part * (m[0] * x + m[1] * y + m[2])
                    down += part * (m[3] * x + m[4] * y + m[5])
                    total += part
                flow[n, j, i, 0], flow[n, j, i, 1] = across / total, down / total
                one = np.float32(1.0)
                occlusion[n, j, i] = one / (one + _exp(-_load(line[channels - 1])))


@_compiled
def blend(
    features: np.ndarray,
    flow: np.ndarray,
    occlusion: np.ndarray,
    corners: bool,
    generated: np.ndarray,
    lie: int,
    warped: bool,
    out: np.ndarray,
) -> None:
    """Source features warped by the flow where the source shows them, generated ones elsewhere.

    Args:
        features: (H, W, C) of the source.
        flow: (b, h, w, 2) float32 source coordinates; resized to (H, W) bilinearly.
        occlusion: (b, h, w) float32, 1 where the source shows what is needed.
        corners: grid convention of warp and resize.
        generated: features as `lie` tells, of the dtype of `out`.
        lie: NONE, SAME or PHASES.
        warped: False leaves the source out: `out` is what was generated, pixel by pixel.
        out: (b, H, W, C), written: `warped * occlusion + generated * (1 - occlusion)`.
    """
    height, width, channels = features.shape
    source = features.reshape(height * width, channels)
    for n in range(len(out)):
        for j in range(height):
            rows = _between(j, height, flow.shape[1], corners)
            for i in range(width):
                x, y, shown = np.float32(0.0), np.float32(0.0), np.float32(0.0)
                if warped:
                    columns = _between(i, width, flow.shape[2], corners)
                    x, y, shown = _flow_at(flow[n], occlusion[n], rows, columns)
                x0, x1, u0, u1 = _taps(_pixel(x, width, corners), width)
                y0, y1, v0, v1 = _taps(_pixel(y, height, corners), height)
                v0, v1 = v0 * shown, v1 * shown
                a, b, c, d = v0 * u0, v0 * u1, v1 * u0, v1 * u1
                s0, s1 = source[y0 * width + x0], source[y0 * width + x1]
                s2, s3 = source[y1 * width + x0], source[y1 * width + x1]
                line = out[n, j, i]
                if lie == NONE:
                    for e in range(channels):
                        value = a * _load(s0[e]) + b * _load(s1[e])
                        _store(line, e, value + (c * _load(s2[e]) + d * _load(s3[e])))
                    continue
                hidden = np.float32(1.0) - shown
                if lie == PHASES:
                    p, q = j % 2, i % 2
                    first = (2 * p + q) * channels
                    made = generated[n, j // 2 + p, i // 2 + q, first : first + channels]
                else:
                    made = generated[n, j, i]
                for e in range(channels):
                    value = a * _load(s0[e]) + b * _load(s1[e])
                    value += c * _load(s2[e]) + d * _load(s3[e])
                    _store(line, e, value + hidden * _load(made[e]))


@_compiled
def join(phases: np.ndarray, skip: np.ndarray, out: np.ndarray) -> None:
    """Phases put in their places, with a skip behind them.

    Args:
        phases: (b, h + 1, w + 1, 4 C).
        skip: (b, 2 h, 2 w, S).
        out: (b, 2 h, 2 w, C + S), written.
    """
    count, height, width, beside = skip.shape
    channels = out.shape[3] - beside
    for n in range(count):
        for j in range(height):
            p = j % 2
            for i in range(width):
                q = i % 2
                made, first = phases[n, j // 2 + p, i // 2 + q], (2 * p + q) * channels
                line, kept = out[n, j, i], skip[n, j, i]
                for e in range(channels):
                    line[e] = made[first + e]
                for e in range(beside):
                    line[channels + e] = kept[e]


@_compiled
def picture(
    photo: np.ndarray,
    flow: np.ndarray,
    occlusion: np.ndarray,
    corners: bool,
    logits: np.ndarray,
    warped: bool,
    painted: np.ndarray,
    out: np.ndarray,
) -> None:
    """The frames: sigmoid of the generator's logits, blended with the warped photo.

    Args:
        photo: (H, W, 3) float32 in [0, 1].
        flow: as in `blend`.
        occlusion: as in `blend`.
        corners: as in `blend`.
        logits: (b, H / 2, W / 2, 12), in the order that a pixel shuffle by 2 reads.
        warped: False leaves the photo out.
        painted: (b, 3, H, W) float32, written: the generated picture; or of size 0.
        out: (b, H, W, 3) uint8, written.
    """
    height, width = photo.shape[:2]
    one = np.float32(1.0)
    for n in range(len(out)):
        for j in range(height):
            rows = _between(j, height, flow.shape[1], corners)
            for i in range(width):
                x, y, shown = np.float32(0.0), np.float32(0.0), np.float32(0.0)
                if warped:
                    columns = _between(i, width, flow.shape[2], corners)
                    x, y, shown = _flow_at(flow[n], occlusion[n], rows, columns)
                x0, x1, u0, u1 = _taps(_pixel(x, width, corners), width)
                y0, y1, v0, v1 = _taps(_pixel(y, height, corners), height)
                a, b, c, d = v0 * u0, v0 * u1, v1 * u0, v1 * u1
                for e in range(3):
                    logit = _load(logits[n, j // 2, i // 2, 4 * e + 2 * (j % 2) + i % 2])
                    made = one / (one + _exp(-logit))
                    if painted.size:
                        painted[n, e, j, i] = made
                    seen = a * photo[y0, x0, e] + b * photo[y0, x1, e]
                    seen += c * photo[y1, x0, e] + d * photo[y1, x1, e]
                    value = min(max(seen * shown + made * (one - shown), np.float32(0.0)), one)
                    out[n, j, i, e] = np.uint8(value * np.float32(255.0) + np.float32(0.5))
