"""Convolutions for inference on a CPU: folded kernels, packed once, channels last."""

import torch
import torch.nn.functional as F
from torch import Tensor

from mraa.fast.folding import Kernel
from mraa.fast.winograd import Winograd, fits

ScaleShift = tuple[Tensor, Tensor]
"""Scale and shift (C,) of what is left of a batch norm."""


def _packs() -> bool:
    """Whether this torch has oneDNN's packed convolutions (all CPU builds for x86 have)."""
    return torch.backends.mkldnn.is_available() and hasattr(
        torch.ops.mkldnn, "_convolution_pointwise"
    )


class Convolution:
    """A convolution with an optional ReLU, in one type, its weights in oneDNN's own order.

    Args:
        kernel: weights in float32.
        shape: (B, I, H, W) of the input, for which the weights are packed.
        dtype: float32 or bfloat16, of input and output.
        padding: on all four sides, or above and below, left and right.
        stride: in both directions.
        relu: whether negative results become 0.
        scale_shift: (I,) each, applied before a ReLU before the convolution.
    """

    def __init__(
        self,
        kernel: Kernel,
        shape: tuple[int, int, int, int],
        *,
        dtype: torch.dtype = torch.float32,
        padding: int | tuple[int, int] = 0,
        stride: int = 1,
        relu: bool = True,
        scale_shift: ScaleShift | None = None,
    ) -> None:
        self.taps = kernel.weight.shape[2] * kernel.weight.shape[3]
        layout = torch.channels_last
        self.weight = kernel.weight.to(dtype, memory_format=layout)
        self.bias = kernel.bias.to(dtype)
        self.padding = [padding] * 2 if isinstance(padding, int) else list(padding)
        self.stride, self.relu = [stride] * 2, relu
        self.scale_shift = None
        if scale_shift is not None:
            self.scale_shift = tuple(v.to(dtype)[:, None, None] for v in scale_shift)
        self.packed = _packs()
        if self.packed:
            self.weight = torch.ops.mkldnn._reorder_convolution_weight(
                self.weight, self.padding, self.stride, [1, 1], 1, list(shape)
            )

    def __call__(self, x: Tensor, residual: Tensor | None = None) -> Tensor:
        """(B, I, H, W) to (B, O, H', W'), both channels last; `residual` comes before the ReLU."""
        if self.scale_shift is not None:
            scale, shift = self.scale_shift
            x = torch.addcmul(shift, x, scale).relu_()
        relu = self.relu and residual is None
        if self.packed:
            end = "relu" if relu else "none"
            y = torch.ops.mkldnn._convolution_pointwise(
                x, self.weight, self.bias, self.padding, self.stride, [1, 1], 1, end, [], ""
            )
        else:
            y = F.conv2d(x, self.weight, self.bias, self.stride, self.padding)
            y = y.relu_() if relu else y
        if residual is None:
            return y
        y.add_(residual)
        return y.relu_() if self.relu else y


def same_convolution(
    kernel: Kernel,
    shape: tuple[int, int, int, int],
    *,
    dtype: torch.dtype,
    relu: bool = True,
    scale_shift: ScaleShift | None = None,
) -> "Convolution | Winograd":
    """A convolution that keeps height and width, done the fastest way; arguments as above."""
    if fits(kernel, shape):
        return Winograd(kernel, dtype=dtype, relu=relu, scale_shift=scale_shift)
    padding = kernel.weight.shape[-1] // 2
    return Convolution(
        kernel, shape, dtype=dtype, padding=padding, relu=relu, scale_shift=scale_shift
    )
