"""The transforms of `mraa.fast.winograd` as compiled loops over channels.

They also do what lies beside the convolution: scale, shift and ReLU before it, bias, residual and
ReLU behind it. Arrays are C-contiguous float32. A strip is a run of numbers in a flat array.
"""

import numpy as np

from mraa.fast.compiled import compiled


@compiled
def _input6(s: np.ndarray, a: int, step: int, t: np.ndarray, to: int, jump: int, n: int) -> None:
    """`B^T` of F(4, 3): six strips of `s`, `step` apart from `a` on, to six of `t`.

    Places and lengths are unsigned, so that no index is taken from the end; each strip has a loop
    of its own, which the compiler turns into vectors.
    """
    b = a + step
    c = b + step
    d = c + step
    e = d + step
    f = e + step
    two, four, five = np.float32(2), np.float32(4), np.float32(5)
    for i in range(n):
        t[to + i] = four * s[a + i] - five * s[c + i] + s[e + i]
    to += jump
    for i in range(n):
        t[to + i] = (s[e + i] - four * s[c + i]) + (s[d + i] - four * s[b + i])
    to += jump
    for i in range(n):
        t[to + i] = (s[e + i] - four * s[c + i]) - (s[d + i] - four * s[b + i])
    to += jump
    for i in range(n):
        t[to + i] = (s[e + i] - s[c + i]) + two * (s[d + i] - s[b + i])
    to += jump
    for i in range(n):
        t[to + i] = (s[e + i] - s[c + i]) - two * (s[d + i] - s[b + i])
    to += jump
    for i in range(n):
        t[to + i] = four * s[b + i] - five * s[d + i] + s[f + i]


@compiled
def _input4(s: np.ndarray, a: int, step: int, t: np.ndarray, to: int, jump: int, n: int) -> None:
    """`B^T` of F(3, 2): four strips to four, as `_input6`."""
    b = a + step
    c = b + step
    d = c + step
    for i in range(n):
        t[to + i] = s[a + i] - s[c + i]
    to += jump
    for i in range(n):
        t[to + i] = s[b + i] + s[c + i]
    to += jump
    for i in range(n):
        t[to + i] = s[c + i] - s[b + i]
    to += jump
    for i in range(n):
        t[to + i] = s[b + i] - s[d + i]


@compiled
def _output6(s: np.ndarray, a: int, step: int, t: np.ndarray, to: int, jump: int, n: int) -> None:
    """`A^T` of F(4, 3): six strips to four, as `_input6`."""
    b = a + step
    c = b + step
    d = c + step
    e = d + step
    f = e + step
    two, four, eight = np.float32(2), np.float32(4), np.float32(8)
    for i in range(n):
        t[to + i] = s[a + i] + (s[b + i] + s[c + i]) + (s[d + i] + s[e + i])
    to += jump
    for i in range(n):
        t[to + i] = (s[b + i] - s[c + i]) + two * (s[d + i] - s[e + i])
    to += jump
    for i in range(n):
        t[to + i] = (s[b + i] + s[c + i]) + four * (s[d + i] + s[e + i])
    to += jump
    for i in range(n):
        t[to + i] = (s[b + i] - s[c + i]) + eight * (s[d + i] - s[e + i]) + s[f + i]


@compiled
def _output4(s: np.ndarray, a: int, step: int, t: np.ndarray, to: int, jump: int, n: int) -> None:
    """`A^T` of F(3, 2): four strips to three, as `_input6`."""
    b = a + step
    c = b + step
    d = c + step
    for i in range(n):
        t[to + i] = s[a + i] + s[b + i] + s[c + i]
    to += jump
    for i in range(n):
        t[to + i] = s[b + i] - s[c + i]
    to += jump
    for i in range(n):
        t[to + i] = s[b + i] + s[c + i] - s[d + i]


@compiled
def _gather(
    x: np.ndarray,
    frame: int,
    top: int,
    left: int,
    scale: np.ndarray,
    shift: np.ndarray,
    out: np.ndarray,
) -> None:
    """Pixels (s, s, C) from (`top`, `left`) on, zeros where there are none, after the line."""
    _, height, width, channels = x.shape
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            row, column = top + i, left + j
            if not (0 <= row < height and 0 <= column < width):
                out[i, j] = 0
            elif scale.size:
                for e in range(channels):
                    value = x[frame, row, column, e] * scale[e] + shift[e]
                    out[i, j, e] = max(value, np.float32(0))
            else:
                for e in range(channels):
                    out[i, j, e] = x[frame, row, column, e]


@compiled
def transform(
    x: np.ndarray,
    scale: np.ndarray,
    shift: np.ndarray,
    m: int,
    grid: tuple[int, int],
    first: int,
    count: int,
    out: np.ndarray,
) -> None:
    """`B^T d B` of tiles `first` to `first + count`.

    Args:
        x: (b, h, w, C) float32; zeros lie around.
        scale: (C,) float32, of the line before the ReLU before the convolution; or of size 0.
        shift: (C,) float32.
        m: pixels from one tile to the next, 4 for F(4, 3), 3 for F(3, 2); the first begins one
            pixel outside.
        grid: tiles down and across a frame.
        first: number of a tile, counted along rows, then columns, then frames.
        count: number of tiles.
        out: (36 or 16, T, C), the first `count` of T written.
    """
    _, height, width, channels = x.shape
    size = 6 if m == 4 else 4
    tile = np.empty((size, size, channels), np.float32)
    half = np.empty(size * size * channels, np.float32)
    pixels, seen, target = x.reshape(-1), tile.reshape(-1), out.reshape(-1)
    each, row_length = np.uintp(channels), np.uintp(size * channels)
    jump = np.uintp(out.shape[1] * channels)
    for t in range(count):
        frame, rest = divmod(first + t, grid[0] * grid[1])
        top, left = m * (rest // grid[1]) - 1, m * (rest % grid[1]) - 1
        inside = top >= 0 and left >= 0 and top + size <= height and left + size <= width
        source, place, step = seen, np.uintp(0), row_length
        if inside and not scale.size:
            source, step = pixels, np.uintp(width * channels)
            place = np.uintp(((frame * height + top) * width + left) * channels)
        else:
            _gather(x, frame, top, left, scale, shift, tile)
        if m == 4:
            _input6(source, place, step, half, np.uintp(0), row_length, row_length)
        else:
            _input4(source, place, step, half, np.uintp(0), row_length, row_length)
        for i in range(size):
            place = np.uintp(i * size * channels)
            to = np.uintp((i * size * out.shape[1] + t) * channels)
            if m == 4:
                _input6(half, place, each, target, to, jump, each)
            else:
                _input4(half, place, each, target, to, jump, each)


@compiled
def restore(
    products: np.ndarray,
    bias: np.ndarray,
    floor: float,
    residual: np.ndarray,
    first: int,
    count: int,
    m: int,
    out: np.ndarray,
) -> None:
    """`A^T M A` of tiles, with bias, residual and ReLU.

    Args:
        products: (36 or 16, T, O).
        bias: (O,) float32.
        floor: float32; 0 for a ReLU, minus infinity for none.
        residual: (b, h, w, O), added before the ReLU; or of size 0.
        first: as in `transform`.
        count: as in `transform`.
        m: 4 or 3, as in `transform`.
        out: (b, h, w, O), h and w whole tiles; the tiles' pixels are written.
    """
    _, height, width, channels = out.shape
    size = 6 if m == 4 else 4
    across, tiles = width // m, (height // m) * (width // m)
    half = np.empty(m * size * channels, np.float32)
    source, target, kept = products.reshape(-1), out.reshape(-1), residual.reshape(-1)
    each, half_row = np.uintp(channels), np.uintp(size * channels)
    step = np.uintp(size * products.shape[1] * channels)
    for t in range(count):
        frame, rest = divmod(first + t, tiles)
        row, column = divmod(rest, across)
        for j in range(size):
            place = np.uintp((j * products.shape[1] + t) * channels)
            to = np.uintp(j * channels)
            if m == 4:
                _output6(source, place, step, half, to, half_row, each)
            else:
                _output4(source, place, step, half, to, half_row, each)
        for i in range(m):
            place = np.uintp(i * size * channels)
            corner = ((frame * height + row * m + i) * width + column * m) * channels
            if m == 4:
                _output6(half, place, each, target, np.uintp(corner), each, each)
            else:
                _output4(half, place, each, target, np.uintp(corner), each, each)
            for j in range(m):
                at = np.uintp(corner + j * channels)
                for e in range(each):
                    value = target[at + e] + bias[e]
                    if kept.size:
                        value += kept[at + e]
                    target[at + e] = max(value, floor)
