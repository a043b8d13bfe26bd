"""The flow predictor for inference on a CPU: folded, packed, channels last.

Computes what `mraa.flow.FlowPredictor` computes for one source and B poses, with the rewrites of
`mraa.fast.folding` and the loops of `mraa.fast.warp_kernel`. Tensors are (B, C, H, W) with channels
last in memory, arrays (B, H, W, C).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from mraa.affine import inverse
from mraa.blocks import Hourglass
from mraa.fast import warp_kernel
from mraa.fast.convolution import Convolution, same_convolution
from mraa.fast.folding import columns, doubling, fold, stacked
from mraa.flow import FlowPredictor, region_maps
from mraa.regions import Regions

Shape = tuple[int, int, int, int]


def empty(shape: Shape, dtype: torch.dtype) -> Tensor:
    """An unset tensor (B, C, H, W), channels last."""
    return torch.empty(shape, dtype=dtype, memory_format=torch.channels_last)


def pixels(x: Tensor) -> np.ndarray:
    """The memory of (B, C, H, W), channels last, as an array (B, H, W, C); bfloat16 as bits."""
    bits = x.view(torch.uint16) if x.dtype == torch.bfloat16 else x
    return bits.permute(0, 2, 3, 1).numpy()


def framed(image: np.ndarray) -> np.ndarray:
    """An array (H, W, C) with zeros around, where warps end: ((H + 3) (W + 3), C)."""
    padded = np.pad(image, ((1, 2), (1, 2), (0, 0)))
    return np.ascontiguousarray(padded).reshape(-1, image.shape[2])


def planes(image: Tensor) -> np.ndarray:
    """A picture (1, 3, H, W) `framed`, colour by colour: (3, (H + 3) (W + 3)) float32."""
    return np.ascontiguousarray(framed(image[0].permute(1, 2, 0).numpy()).T, np.float32)


@dataclass(frozen=True)
class Field:
    """Flow and occlusion of B frames as arrays."""

    flow: np.ndarray
    """(B, h, w, 2) float32 source coordinates (x, y) in [-1, 1]."""
    occlusion: np.ndarray
    """(B, h, w) float32 in [0, 1]."""
    corners: bool
    """Grid convention of warps and resizes."""
    features: Tensor
    """(B, C, h, w), what the flow was made of (`mraa.flow.Flow.features`)."""


class FoldedHourglass:
    """`mraa.blocks.Hourglass` for inputs of one shape."""

    def __init__(self, hourglass: Hourglass, shape: Shape, dtype: torch.dtype) -> None:
        count, channels, height, width = shape
        self.downs, self.ups = [], []
        block: Any
        for block in hourglass.encoder.down_blocks:
            kernel = fold(block.conv, block.norm)
            at = (count, channels, height, width)
            self.downs.append(same_convolution(kernel, at, dtype=dtype))
            channels, height, width = len(kernel.bias), height // 2, width // 2
        for block in hourglass.decoder.up_blocks:
            self.ups.append(up_convolution(block, (count, height, width), dtype))
            height, width = height * 2, width * 2

    def __call__(self, x: Tensor) -> Tensor:
        """(B, C, H, W) to (B, width + C, H, W)."""
        skips = []
        for down in self.downs:
            skips.append(x)
            x = F.avg_pool2d(down(x), 2)
        for up, skip in zip(self.ups, reversed(skips), strict=True):
            phases = up(x)
            count, beside, height, width = skip.shape
            x = empty((count, phases.shape[1] // 4 + beside, height, width), skip.dtype)
            warp_kernel.join(pixels(phases), pixels(skip), pixels(x))
        return x


def up_convolution(block: Any, at: tuple[int, int, int], dtype: torch.dtype) -> Convolution:
    """An `UpBlock` as one convolution to phases, for inputs of B, h, w `at`."""
    kernel = doubling(fold(block.conv, block.norm))
    shape = (at[0], kernel.weight.shape[1], *at[1:])
    return Convolution(kernel, shape, dtype=dtype, padding=1)


class FoldedFlow:
    """`mraa.flow.FlowPredictor` for one source.

    Args:
        predictor: in eval mode.
        small: (1, 3, h, w) float32, the small source.
        regions: (1, K) of the source.
        count: B, frames at once.
        dtype: of the convolutions; all else is float32.
    """

    def __init__(
        self,
        predictor: FlowPredictor,
        small: Tensor,
        regions: Regions,
        count: int,
        dtype: torch.dtype,
    ) -> None:
        height, width = small.shape[2:]
        self.shape = (count, 4 * (regions.shift.shape[1] + 1), height, width)
        self.dtype, self.corners = dtype, predictor.align_corners
        self.revert = predictor.revert_axis_swap
        self.small = planes(small)
        self.regions = regions
        self.still = np.empty((height, regions.shift.shape[1], width), np.float32)
        warp_kernel.gaussians(regions.shift[0].numpy(), _precision(regions)[0], self.still)
        self.hourglass = FoldedHourglass(predictor.hourglass, self.shape, dtype)
        features = predictor.hourglass.channels_out
        kernel = stacked(fold(predictor.mask), fold(predictor.occlusion))
        at = (count, features, height, width)
        size = kernel.weight.shape[-1]
        self.logits = Convolution(
            columns(kernel), at, dtype=dtype, padding=(size // 2, 0), relu=False
        )

    def __call__(self, driving: Regions, background: Tensor) -> Field:
        """Flow and occlusion of regions (B, K) and background homographies (B, 3, 3)."""
        matrix, offset = region_maps(self.regions, driving, revert_axis_swap=self.revert)
        maps = torch.cat([matrix, offset[..., None]], dim=-1).flatten(-2).contiguous().numpy()
        far = background.contiguous().numpy()
        seen = empty(self.shape, self.dtype)
        shift = driving.shift.contiguous().numpy()
        warp_kernel.flow_input(
            self.small,
            self.still,
            shift,
            _precision(driving),
            maps,
            far,
            self.corners,
            pixels(seen),
        )
        features = self.hourglass(seen)
        logits = self.logits(features)
        count, _, height, width = self.shape
        flow = np.empty((count, height, width, 2), np.float32)
        occlusion = np.empty((count, height, width), np.float32)
        warp_kernel.flow_result(pixels(logits), maps, far, flow, occlusion)
        return Field(flow, occlusion, self.corners, features)


def _precision(regions: Regions) -> np.ndarray:
    """Entries xx, xy, yy of the inverse covariances, (B, K, 3)."""
    return inverse(regions.covariance).flatten(-2)[..., [0, 1, 3]].contiguous().numpy()
