"""Image pyramids: pictures at several resolutions, and their bands."""

import torch.nn.functional as F
from torch import Tensor, nn

from mraa.blocks import AntiAliasDown

PYRAMID_SCALES = (1.0, 0.5, 0.25, 0.125)
"""Resolutions at which pictures are compared (MRAA)."""


class ImagePyramid(nn.Module):
    """Anti-aliased versions of a picture at `PYRAMID_SCALES`."""

    def __init__(self) -> None:
        super().__init__()
        self.downs = nn.ModuleList(AntiAliasDown(3, scale) for scale in PYRAMID_SCALES)

    def forward(self, image: Tensor) -> list[Tensor]:
        """Images (B, 3, H, W) to one (B, 3, H * scale, W * scale) a scale."""
        return [down(image) for down in self.downs]


def laplacian_distance(predictions: list[Tensor], truths: list[Tensor]) -> Tensor:
    """Sum over the bands of two pyramids of mean |band of the prediction - band of the truth|."""
    differences = [a - b for a, b in zip(predictions, truths, strict=True)]
    total = differences[-1].abs().mean()
    for fine, coarse in zip(differences[:-1], differences[1:], strict=True):
        low = F.interpolate(coarse, size=fine.shape[2:], mode="bilinear", align_corners=False)
        total = total + (fine - low).abs().mean()
    return total
