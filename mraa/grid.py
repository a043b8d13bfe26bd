"""The one coordinate convention: (x right, y down) in [-1, 1], corners at the corner pixels."""

from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor


def coordinate_grid(height: int, width: int, device: torch.device | None = None) -> Tensor:
    """Coordinates of every pixel, corner aligned: `x = 2 i / (width - 1) - 1`.

    Returns:
        (height, width, 2) float32, last axis (x, y).
    """
    x = torch.linspace(-1, 1, width, device=device)
    y = torch.linspace(-1, 1, height, device=device)
    return torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1)


class _Planar(torch.autograd.Function):
    """Channels-last float32 image to planes, which grid_sample works on, and its gradient back.

    Without it the layouts of activations and gradients mix from here on, and every batch norm
    and addition after a warp takes a slow path.
    """

    @staticmethod
    def forward(ctx: Any, image: Tensor) -> Tensor:
        ctx.dtype = image.dtype
        return image.to(torch.float32, memory_format=torch.contiguous_format)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        return gradients[0].to(ctx.dtype, memory_format=torch.channels_last)


def warp(image: Tensor, flow: Tensor, *, align_corners: bool, padding: str = "zeros") -> Tensor:
    """Sample `image` at the coordinates `flow` (backward warping), bilinear, in float32.

    Args:
        image: (B, C, H, W).
        flow: (B, h, w, 2) coordinates (x, y) in [-1, 1].
        align_corners: True where -1 and 1 are centres of the corner pixels, as in
            `coordinate_grid`; False is what the released MRAA weights were trained with.
        padding: what lies outside, as in `torch.nn.functional.grid_sample`.

    Returns:
        (B, C, h, w), dtype of `image`.
    """
    interleaved = image.is_contiguous(memory_format=torch.channels_last)
    with torch.autocast(image.device.type, enabled=False):
        sampled = F.grid_sample(
            _Planar.apply(image) if interleaved else image.float(),
            flow.float(),
            mode="bilinear",
            padding_mode=padding,
            align_corners=align_corners,
        )
    layout = torch.channels_last if interleaved else torch.contiguous_format
    return sampled.to(image.dtype, memory_format=layout)


def resize_flow(flow: Tensor, height: int, width: int, *, align_corners: bool) -> Tensor:
    """Bilinear resize of a flow field: (B, h, w, 2) to (B, height, width, 2)."""
    if flow.shape[1:3] == (height, width):
        return flow
    return F.interpolate(
        flow.permute(0, 3, 1, 2), size=(height, width), mode="bilinear", align_corners=align_corners
    ).permute(0, 2, 3, 1)


def resize_map(image: Tensor, height: int, width: int, *, align_corners: bool) -> Tensor:
    """Bilinear resize of a map such as the occlusion: (B, C, h, w) to (B, C, height, width)."""
    if image.shape[2:] == (height, width):
        return image
    return F.interpolate(image, size=(height, width), mode="bilinear", align_corners=align_corners)
