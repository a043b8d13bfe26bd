"""Convolutions in float32 by Winograd's minimal filtering: 2.25 products a pixel in place of 9.

Lavin and Gray, "Fast Algorithms for Convolutional Neural Networks" (CVPR 2016): a tile of
m x m outputs of a kernel of r x r is `A^T [(G g G^T) * (B^T d B)] A`; the products in the middle,
over all tiles and channels, are (m + r - 1)^2 matrix products, which oneDNN does near the
hardware's peak. F(4, 3) keeps float32 to about 1e-6; F(3, 2), for the 2x2 kernels before a
doubling, takes 1.8 products in place of 4. In bfloat16 F(2, 3) would gain 1.28 times in all, which
is not worth its code.

The transforms are compiled loops over channels, which also do what lies beside the convolution:
scale, shift and ReLU before it, bias, residual and ReLU behind it. Arrays are C-contiguous float32;
a strip is a run of numbers in a flat array.
"""

import numpy as np
import torch
from torch import Tensor

from mraa.fast.compiled import compiled
from mraa.fast.folding import Kernel

Rows = tuple[np.ndarray, np.ndarray]
"""A matrix by its entries other than 0, at most five a row: columns (n, 5) and values (n, 5)."""


def rows(matrix: tuple[tuple[int, ...], ...]) -> Rows:
    """The rows of a matrix; what a row has less than five entries is filled up with zeros."""
    columns, values = np.zeros((2, len(matrix), 5), np.float32)
    for row, entries in enumerate(matrix):
        (places,) = np.nonzero(entries)
        columns[row, : len(places)] = places
        values[row, : len(places)] = np.array(entries)[places]
    return columns.astype(np.uintp), values


INPUT = {
    4: rows(
        (
            (4, 0, -5, 0, 1, 0),
            (0, -4, -4, 1, 1, 0),
            (0, 4, -4, -1, 1, 0),
            (0, -2, -1, 2, 1, 0),
            (0, 2, -1, -2, 1, 0),
            (0, 4, 0, -5, 0, 1),
        )
    ),
    3: rows(((1, 0, -1, 0), (0, 1, 1, 0), (0, -1, 1, 0), (0, 1, 0, -1))),
}
"""`B^T` of F(4, 3) and F(3, 2)."""

OUTPUT = {
    4: rows(((1, 1, 1, 1, 1, 0), (0, 1, -1, 2, -2, 0), (0, 1, 1, 4, 4, 0), (0, 1, -1, 8, -8, 1))),
    3: rows(((1, 1, 1, 0), (0, 1, -1, 0), (0, 1, 1, -1))),
}
"""`A^T` of both."""


@compiled
def _product(
    matrix: Rows, s: np.ndarray, at: int, step: int, t: np.ndarray, to: int, jump: int, n: int
) -> None:
    """A matrix times strips of `s`, `step` apart from `at` on; strips of `t`, `jump` apart.

    Places and lengths are unsigned, so that no index is taken from the end; the compiler turns
    the loop over a strip into vectors.
    """
    columns, values = matrix
    for row in range(len(columns)):
        a, b, c = (
            at + step * columns[row, 0],
            at + step * columns[row, 1],
            at + step * columns[row, 2],
        )
        d, e = at + step * columns[row, 3], at + step * columns[row, 4]
        u, v, w, x, y = (
            values[row, 0],
            values[row, 1],
            values[row, 2],
            values[row, 3],
            values[row, 4],
        )
        if y == 0 and x == 0:
            for i in range(n):
                t[to + i] = u * s[a + i] + v * s[b + i] + w * s[c + i]
        else:
            for i in range(n):
                t[to + i] = (
                    (u * s[a + i] + v * s[b + i]) + (w * s[c + i] + x * s[d + i]) + y * s[e + i]
                )
        to += jump


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
    """Pixels (s, s, C) from (`top`, `left`) on, zeros where there are none, scaled and shifted."""
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
    matrix: Rows,
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
        matrix: `B^T`.
        x: (b, h, w, C) float32; zeros lie around.
        scale: (C,) float32, applied before a ReLU before the convolution; or of size 0.
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
        _product(matrix, source, place, step, half, np.uintp(0), row_length, row_length)
        for i in range(size):
            place = np.uintp(i * size * channels)
            to = np.uintp((i * size * out.shape[1] + t) * channels)
            _product(matrix, half, place, each, target, to, jump, each)


@compiled
def restore(
    matrix: Rows,
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
        matrix: `A^T`.
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
            _product(matrix, source, place, step, half, to, half_row, each)
        for i in range(m):
            place = np.uintp(i * size * channels)
            corner = ((frame * height + row * m + i) * width + column * m) * channels
            _product(matrix, half, place, each, target, np.uintp(corner), each, each)
            for j in range(m):
                at = np.uintp(corner + j * channels)
                for e in range(each):
                    value = target[at + e] + bias[e]
                    if kept.size:
                        value += kept[at + e]
                    target[at + e] = max(value, floor)


TILES = 128
"""Tiles transformed and multiplied at once, which then are still in the processor's cache."""

_G4 = (
    (1 / 4, 0, 0),
    (-1 / 6, -1 / 6, -1 / 6),
    (-1 / 6, 1 / 6, -1 / 6),
    (1 / 24, 1 / 12, 1 / 6),
    (1 / 24, -1 / 12, 1 / 6),
    (0, 0, 1),
)
_G3 = ((1, 0), (1 / 2, 1 / 2), (1 / 2, -1 / 2), (0, 1))
_KERNEL = {3: _G3, 4: _G4}


def fits(kernel: Kernel, shape: tuple[int, int, int, int], dtype: torch.dtype) -> bool:
    """Whether a convolution of `shape` (B, C, H, W) is done faster this way than directly."""
    outputs, inputs, size = kernel.weight.shape[:3]
    _, _, height, width = shape
    large = min(inputs, outputs) >= 64 and height * width >= 256
    whole = size == 2 or (size == 3 and height % 4 == width % 4 == 0)
    return dtype == torch.float32 and large and whole


def transformed_kernel(weight: Tensor, m: int) -> Tensor:
    """`G g G^T` of (O, C, r, r) as matrices ((m + r - 1)^2, C, O), float32."""
    g = torch.tensor(_KERNEL[m], dtype=torch.float64)
    parts = torch.einsum("ik,ockl,jl->ijco", g, weight.double(), g)
    return parts.flatten(0, 1).float().contiguous()


class Winograd:
    """A 3x3 or 2x2 convolution with a padding of 1, and what lies before and behind it.

    Args:
        kernel: (O, C, r, r).
        relu: whether negative results become 0.
        scale_shift: (C,) each, applied before a ReLU before the convolution.
    """

    def __init__(
        self, kernel: Kernel, *, relu: bool = True, scale_shift: tuple[Tensor, Tensor] | None = None
    ) -> None:
        self.size = kernel.weight.shape[-1]
        self.m = 3 if self.size == 2 else 4
        self.matrices = transformed_kernel(kernel.weight, self.m)
        self.bias = kernel.bias.numpy()
        self.floor = np.float32(0.0 if relu else -np.inf)
        none = torch.empty(0)
        scale, shift = (none, none) if scale_shift is None else scale_shift
        self.scale, self.shift = scale.float().numpy(), shift.float().numpy()

    def __call__(self, x: Tensor, residual: Tensor | None = None) -> Tensor:
        """Convolve, channels last; `residual` is added before the ReLU.

        Args:
            x: (B, C, H, W); for 3x3 kernels H and W are multiples of 4.
            residual: (B, O, H, W), for 3x3 kernels alone.

        Returns:
            (B, O, H, W); of a 2x2 kernel (B, O, H', W'), where H' >= H + 1 and W' >= W + 1 are
            the next multiples of 3 and what lies beyond H + 1 and W + 1 means nothing.
        """
        count, channels, height, width = x.shape
        many, _, outputs = self.matrices.shape
        edge = 1 if self.size == 2 else 0
        grid = (-(-(height + edge) // self.m), -(-(width + edge) // self.m))
        out = torch.empty(
            (count, outputs, grid[0] * self.m, grid[1] * self.m), memory_format=torch.channels_last
        )
        tiles = count * grid[0] * grid[1]
        size = min(TILES, tiles)
        inputs = torch.empty((many, size, channels))
        products = torch.empty((many, size, outputs))
        source, target = (v.permute(0, 2, 3, 1).numpy() for v in (x, out))
        kept = target[:0] if residual is None else residual.permute(0, 2, 3, 1).numpy()
        before, after = inputs.numpy(), products.numpy()
        for first in range(0, tiles, size):
            part = min(size, tiles - first)
            transform(
                INPUT[self.m], source, self.scale, self.shift, self.m, grid, first, part, before
            )
            torch.bmm(inputs, self.matrices, out=products)
            restore(OUTPUT[self.m], after, self.bias, self.floor, kept, first, part, self.m, target)
        return out
