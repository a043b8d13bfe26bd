"""Convolutions in float32 by Winograd's minimal filtering: 2.25 products a pixel in place of 9.

Lavin and Gray, "Fast Algorithms for Convolutional Neural Networks" (CVPR 2016): a tile of
m x m outputs of a kernel of r x r is `A^T [(G g G^T) * (B^T d B)] A`; the products in the middle,
over all tiles and channels, are (m + r - 1)^2 matrix products, which oneDNN does near the
hardware's peak. F(4, 3) keeps float32 to about 1e-6; F(3, 2), for the 2x2 kernels before a
doubling, takes 1.8 products in place of 4. In bfloat16 F(2, 3) would gain 1.28 times in all, which
is not worth its code.

The transforms are `mraa.fast.winograd_kernel`.
"""

import numpy as np
import torch
from torch import Tensor

from mraa.fast.folding import Kernel
from mraa.fast.winograd_kernel import INPUT, OUTPUT, restore, transform

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
        self,
        kernel: Kernel,
        *,
        relu: bool = True,
        scale_shift: tuple[Tensor, Tensor] | None = None,
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
            (count, outputs, grid[0] * self.m, grid[1] * self.m),
            memory_format=torch.channels_last,
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
