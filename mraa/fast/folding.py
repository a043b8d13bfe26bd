"""Exact rewrites of trained convolutions: batch norm folded, doubling and large kernels by blocks.

All are computed in float64 and hold to float32 rounding.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

PHASES = ((0, 0), (0, 1), (1, 0), (1, 1))
"""(row, column) of the four pixels that one pixel becomes, in the order of their channels."""


@dataclass(frozen=True)
class Kernel:
    """Weights of a convolution without a norm."""

    weight: Tensor
    """(O, I, k, k) float32."""
    bias: Tensor
    """(O,) float32."""


def norm_scale_shift(norm: nn.BatchNorm2d) -> tuple[Tensor, Tensor]:
    """Scale and shift (C,) float64 that a batch norm in eval mode applies."""
    if norm.running_mean is None or norm.running_var is None:
        raise ValueError("a batch norm without running statistics cannot be folded")
    scale = norm.weight.detach().double() / torch.sqrt(norm.running_var.double() + norm.eps)
    return scale, norm.bias.detach().double() - norm.running_mean.double() * scale


def fold(conv: nn.Conv2d, norm: nn.BatchNorm2d | None = None) -> Kernel:
    """One kernel for a convolution and the batch norm behind it."""
    weight = conv.weight.detach().double()
    bias = torch.zeros(len(weight)).double() if conv.bias is None else conv.bias.detach().double()
    if norm is not None:
        scale, shift = norm_scale_shift(norm)
        weight, bias = weight * scale[:, None, None, None], bias * scale + shift
    return Kernel(weight.float().cpu(), bias.float().cpu())


def stacked(*kernels: Kernel) -> Kernel:
    """Kernels that see the same input as one."""
    return Kernel(torch.cat([k.weight for k in kernels]), torch.cat([k.bias for k in kernels]))


def doubling(kernel: Kernel) -> Kernel:
    """A 3x3 kernel behind nearest doubling as four 2x2 kernels before it: 4/9 of the work.

    Pixel (2 y + i, 2 x + j) of the doubled picture sees two rows of the small one, y + i - 1 and
    y + i, and two columns likewise; rows that see the same pixel are added.

    Args:
        kernel: (O, I, 3, 3).

    Returns:
        (4 O, I, 2, 2), phase by phase as in `PHASES`, for a padding of 1: phase (i, j) of pixel
        (y, x) is at place (y + i, x + j) of the (h + 1, w + 1) that the convolution gives.
    """
    rows = {0: torch.tensor([[1, 0, 0], [0, 1, 1]]), 1: torch.tensor([[1, 1, 0], [0, 0, 1]])}
    weight = kernel.weight.double()
    parts = [
        torch.einsum("oikl,rk,cl->oirc", weight, rows[i].double(), rows[j].double())
        for i, j in PHASES
    ]
    return Kernel(torch.cat(parts).float(), kernel.bias.repeat(4))


def blocks(kernel: Kernel) -> Kernel:
    """A kernel for few channels as one that makes 2x2 pixels at a time, with a stride of 2.

    Args:
        kernel: (O, I, k, k), k odd, padding k // 2.

    Returns:
        (4 O, I, k + 1, k + 1), in the order that a pixel shuffle by 2 reads; same padding.
    """
    outputs, inputs, size = kernel.weight.shape[:3]
    weight = torch.zeros(outputs, 4, inputs, size + 1, size + 1)
    for phase, (i, j) in enumerate(PHASES):
        weight[:, phase, :, i : i + size, j : j + size] = kernel.weight
    return Kernel(weight.flatten(0, 1), kernel.bias.repeat_interleave(4))


def columns(kernel: Kernel) -> Kernel:
    """A kernel for few channels as one of its columns side by side, which fill vectors better.

    Args:
        kernel: (O, I, k, k), k odd, padding k // 2.

    Returns:
        (k O, I, k, 1), for a padding of (k // 2, 0): output c of pixel (y, x) is the sum over j of
        channel j O + c of pixel (y, x + j - k // 2). The middle column has the bias.
    """
    outputs, _, size = kernel.weight.shape[:3]
    bias = torch.zeros(size, outputs)
    bias[size // 2] = kernel.bias
    weight = kernel.weight.permute(3, 0, 1, 2).flatten(0, 1)[..., None]
    return Kernel(weight.contiguous(), bias.flatten())
