"""3x3 convolutions by Winograd's minimal filtering: 3 products a pixel in place of 9.

Lavin and Gray, "Fast Algorithms for Convolutional Neural Networks" (CVPR 2016): a tile of outputs
is `A^T [(G g G^T) * (B^T d B)] A`; the products in the middle, over all tiles and channels, are
matrix products, which oneDNN does near the hardware's peak. Tiles are 4 pixels high by F(4, 3) and
2 wide by F(2, 3). F(4, 3) both ways would take 2.25 products, but lose too much in bfloat16.

The transforms are compiled loops over strips, a whole line of tiles with all channels at a time.
For that, pictures are held in `Lines`: (B (H + 1) + 1, 2, W / 2 + 1, C), C-contiguous. A line has
its odd pixels behind a zero, then its even ones before a zero; lines of zeros lie between frames.
"""

import numpy as np
import torch
from torch import Tensor

from mraa.fast.compiled import compiled
from mraa.fast.folding import Kernel
from mraa.fast.warp_kernel import _like, _load

TILES = 512
"""Tiles transformed and multiplied at once, which then are still in the processor's cache."""

_TWO, _FOUR, _FIVE = np.float32(2), np.float32(4), np.float32(5)

_G4 = (
    (1 / 4, 0, 0),
    (-1 / 6, -1 / 6, -1 / 6),
    (-1 / 6, 1 / 6, -1 / 6),
    (1 / 24, 1 / 12, 1 / 6),
    (1 / 24, -1 / 12, 1 / 6),
    (0, 0, 1),
)
_G2 = ((1, 0, 0), (1 / 2, 1 / 2, 1 / 2), (1 / 2, -1 / 2, 1 / 2), (0, 0, 1))


@compiled
def _down(x: np.ndarray, at: int, v: np.ndarray) -> None:
    """`B^T d` of F(4, 3): lines `at` to `at + 6` of x (lines, N) to v (6, N) float32."""
    a, b, c, d, e, f = x[at], x[at + 1], x[at + 2], x[at + 3], x[at + 4], x[at + 5]
    for i in range(len(a)):  # short loops, which the compiler turns into vectors
        v[0, i] = _FOUR * _load(a[i]) - _FIVE * _load(c[i]) + _load(e[i])
        v[5, i] = _FOUR * _load(b[i]) - _FIVE * _load(d[i]) + _load(f[i])
    for i in range(len(a)):
        even, odd = _load(e[i]) - _FOUR * _load(c[i]), _load(d[i]) - _FOUR * _load(b[i])
        v[1, i], v[2, i] = even + odd, even - odd
    for i in range(len(a)):
        even, odd = _load(e[i]) - _load(c[i]), _TWO * (_load(d[i]) - _load(b[i]))
        v[3, i], v[4, i] = even + odd, even - odd


@compiled
def _across(line: np.ndarray, out: np.ndarray, first: int, last: int) -> None:
    """`d B` of F(2, 3): a line (N,) to strips `first` to `last` of out (4, M)."""
    count = last - first
    beside = len(line) // 2 - count
    a, b = line[:count], line[count + beside : 2 * count + beside]
    c, d = line[beside : count + beside], line[count + 2 * beside :]
    p, q, r, s = out[0, first:last], out[1, first:last], out[2, first:last], out[3, first:last]
    for i in range(count):
        p[i], q[i] = _like(a[i] - c[i], out), _like(b[i] + c[i], out)
    for i in range(count):
        r[i], s[i] = _like(c[i] - b[i], out), _like(b[i] - d[i], out)


@compiled
def transform(x: np.ndarray, height: int, first: int, count: int, out: np.ndarray) -> None:
    """`B^T d B` of lines of tiles `first` to `first + count`, counted down, then by frames.

    Args:
        x: `Lines`, each flat, of frames of `height`; float32 or the bits of bfloat16.
        height: H.
        first: number of a line of tiles.
        count: lines of tiles.
        out: (6, 4, many, W / 2, C) of x's type, the first `count` of `many` written.
    """
    each = out.shape[3] * out.shape[4]
    flat = out.reshape((6, 4, -1))
    v = np.empty((6, x.shape[1]), np.float32)
    for t in range(count):
        frame, row = divmod(first + t, height // 4)
        _down(x, frame * (height + 1) + 4 * row, v)
        for k in range(6):
            _across(v[k], flat[k], t * each, (t + 1) * each)


@compiled
def _back(products: np.ndarray, first: int, last: int, even: np.ndarray, odd: np.ndarray) -> None:
    """`M A` of F(2, 3): strips of products (4, N) to the even and odd pixels, float32."""
    a, b = products[0, first:last], products[1, first:last]
    c, d = products[2, first:last], products[3, first:last]
    for i in range(len(even)):
        even[i] = _load(a[i]) + _load(b[i]) + _load(c[i])
    for i in range(len(even)):
        odd[i] = _load(b[i]) - _load(c[i]) - _load(d[i])


@compiled
def _up(
    h: np.ndarray, j: int, bias: np.ndarray, floor: float, kept: np.ndarray, out: np.ndarray
) -> None:
    """Line `j` of `A^T h` of F(4, 3), h (6, N), with bias, residual (or none) and ReLU."""
    edge = h[0] if j == 0 else h[5]
    size, sign = np.float32(2**j), np.float32(1 - j % 2 * 2)
    part = np.float32(j % 3 == 0)
    b, c, d, e = h[1], h[2], h[3], h[4]
    if len(kept):
        for i in range(len(out)):
            value = part * edge[i] + (b[i] + sign * c[i]) + size * (d[i] + sign * e[i])
            out[i] = _like(max(value + bias[i] + _load(kept[i]), floor), out)
    else:
        for i in range(len(out)):
            value = part * edge[i] + (b[i] + sign * c[i]) + size * (d[i] + sign * e[i])
            out[i] = _like(max(value + bias[i], floor), out)


@compiled
def restore(
    products: np.ndarray, height: int, first: int, count: int, bias: np.ndarray, floor: float,
    kept: np.ndarray, out: np.ndarray,
) -> None:  # fmt: skip
    """`A^T M A` of lines of tiles, with bias, residual and ReLU.

    Args:
        products: (6, 4, many, W / 2, O).
        height: as in `transform`.
        first: as in `transform`.
        count: as in `transform`.
        bias: (W / 2 O,) float32.
        floor: float32; 0 for a ReLU, minus infinity for none.
        kept: `Lines`, each flat, added before the ReLU; or no lines. Not `out`: compiled loops are
            slow where a strip that is read may be the one that is written.
        out: `Lines`, each flat; all but the zeros are written.
    """
    each, length = len(bias), out.shape[1]
    beside = length // 2 - each
    flat = products.reshape((6, 4, -1))
    h = np.empty((2, 6, each), np.float32)
    for t in range(count):
        frame, row = divmod(first + t, height // 4)
        for k in range(6):
            _back(flat[k], t * each, (t + 1) * each, h[0, k], h[1, k])
        for j in range(4):
            at = frame * (height + 1) + 4 * row + 1 + j
            for odd in range(2):
                begin = beside if odd else length // 2
                beyond = kept[at, begin : begin + each] if len(kept) else bias[:0].view(kept.dtype)
                _up(h[odd], j, bias, floor, beyond, out[at, begin : begin + each])


def split(x: Tensor) -> Tensor:
    """(B, C, H, W), H and W even, as `Lines`."""
    count, channels, height, width = x.shape
    lines = x.new_zeros(count * (height + 1) + 1, 2, width // 2 + 1, channels)
    pixels, inner = x.permute(0, 2, 3, 1), _inner(lines, count)
    inner[:, :, 1, :-1] = pixels[:, :, 0::2]
    inner[:, :, 0, 1:] = pixels[:, :, 1::2]
    return lines


def joined(lines: Tensor, count: int) -> Tensor:
    """`Lines` of `count` frames as (B, C, H, W), channels last."""
    inner = _inner(lines, count)
    both = torch.stack([inner[:, :, 1, :-1], inner[:, :, 0, 1:]], dim=3)
    return both.flatten(2, 3).permute(0, 3, 1, 2)


def _inner(lines: Tensor, count: int) -> Tensor:
    """The lines (B, H, 2, W / 2 + 1, C) that are not between frames."""
    return lines[1:].view(count, -1, *lines.shape[1:])[:, :-1]


def _array(x: Tensor, *shape: int) -> np.ndarray:
    """The memory of a tensor; bfloat16 as bits."""
    return (x.view(torch.uint16) if x.dtype == torch.bfloat16 else x).view(shape).numpy()


def fits(kernel: Kernel, shape: tuple[int, int, int, int]) -> bool:
    """Whether a convolution of `shape` (B, C, H, W) is done faster this way than directly."""
    outputs, inputs, size = kernel.weight.shape[:3]
    height, width = shape[2:]
    large = min(inputs, outputs) >= 32 and height * width >= 256
    return large and size == 3 and height % 4 == width % 2 == 0


class Winograd:
    """A 3x3 convolution with a padding of 1, and what lies before and behind it.

    Args:
        kernel: (O, C, 3, 3).
        dtype: float32 or bfloat16, of input, output and matrix products.
        relu: whether negative results become 0.
        scale_shift: (C,) each, applied before a ReLU before the convolution.
    """

    def __init__(
        self,
        kernel: Kernel,
        *,
        dtype: torch.dtype = torch.float32,
        relu: bool = True,
        scale_shift: tuple[Tensor, Tensor] | None = None,
    ) -> None:
        down, across = (torch.tensor(g, dtype=torch.float64) for g in (_G4, _G2))
        parts = torch.einsum("ik,ockl,jl->ijco", down, kernel.weight.double(), across)
        self.matrices = parts.flatten(0, 1).to(dtype).contiguous()
        self.bias = kernel.bias
        self.floor = np.float32(0.0 if relu else -np.inf)
        self.scale_shift = None
        if scale_shift is not None:
            self.scale_shift = tuple(v.to(dtype)[:, None, None] for v in scale_shift)

    def __call__(self, x: Tensor, residual: Tensor | None = None) -> Tensor:
        """(B, C, H, W) to (B, O, H, W), channels last; `residual` is added before the ReLU."""
        if self.scale_shift is not None:
            scale, shift = self.scale_shift
            x = torch.addcmul(shift, x, scale).relu_()
        lines = split(x)
        out = lines.new_zeros(*lines.shape[:3], self.matrices.shape[2])
        self.convolve(lines, out, len(x), None if residual is None else split(residual))
        return joined(out, len(x))

    def convolve(self, x: Tensor, out: Tensor, count: int, kept: Tensor | None = None) -> None:
        """The same on `Lines` of `count` frames to `out`, others, which have their zeros."""
        (lines, _, half, channels), outputs = x.shape, out.shape[3]
        height, across = (lines - 1) // count - 1, half - 1
        rows = count * height // 4
        many = max(1, min(TILES // across, rows))
        before = x.new_empty(24, many * across, channels)
        after = x.new_empty(24, many * across, outputs)
        source, target = _array(x, lines, -1), _array(out, lines, -1)
        beside = target[:0] if kept is None else _array(kept, lines, -1)
        tiles = _array(before, 6, 4, many, across, channels)
        products = _array(after, 6, 4, many, across, outputs)
        bias = self.bias.repeat(across).numpy()
        for first in range(0, rows, many):
            part = min(many, rows - first)
            transform(source, height, first, part, tiles)
            torch.bmm(before, self.matrices, out=after)
            restore(products, height, first, part, bias, self.floor, beside, target)
