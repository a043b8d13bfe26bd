"""Convolutions for inference on a CPU: folded kernels, packed once, channels last."""

import torch
import torch.nn.functional as F
from torch import Tensor

from mraa.folding import Kernel


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
        padding: on all four sides.
        stride: in both directions.
        relu: whether negative results become 0.
    """

    def __init__(
        self,
        kernel: Kernel,
        shape: tuple[int, int, int, int],
        *,
        dtype: torch.dtype = torch.float32,
        padding: int = 0,
        stride: int = 1,
        relu: bool = True,
    ) -> None:
        layout = torch.channels_last
        self.weight = kernel.weight.to(dtype, memory_format=layout)
        self.bias = kernel.bias.to(dtype)
        self.padding, self.stride, self.relu = [padding] * 2, [stride] * 2, relu
        self.packed = _packs()
        if self.packed:
            self.weight = torch.ops.mkldnn._reorder_convolution_weight(
                self.weight, self.padding, self.stride, [1, 1], 1, list(shape)
            )

    def __call__(self, x: Tensor) -> Tensor:
        """(B, I, H, W) to (B, O, H', W'), both channels last."""
        if self.packed:
            end = "relu" if self.relu else "none"
            return torch.ops.mkldnn._convolution_pointwise(
                x, self.weight, self.bias, self.padding, self.stride, [1, 1], 1, end, [], ""
            )
        y = F.conv2d(x, self.weight, self.bias, self.stride, self.padding)
        return y.relu_() if self.relu else y
