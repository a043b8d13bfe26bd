"""Region estimator: an image to the mean and covariance of K region heatmaps (MRAA, section 3)."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from mraa.affine import affine_from_covariance
from mraa.blocks import AntiAliasDown, Hourglass
from mraa.grid import coordinate_grid


@dataclass(frozen=True)
class Regions:
    """Pose of K regions in B images, coordinates (x, y) in [-1, 1], float32."""

    shift: Tensor
    """(B, K, 2) centre of each region."""
    covariance: Tensor
    """(B, K, 2, 2) symmetric positive definite."""
    affine: Tensor
    """(B, K, 2, 2) root of the covariance, `A A^T = C`."""
    heatmap: Tensor | None = None
    """(B, K, h, w) non-negative, sums to 1 over space; None when given as numbers."""

    def __getitem__(self, item: slice) -> "Regions":
        """Regions of some of the images."""
        heatmap = None if self.heatmap is None else self.heatmap[item]
        return Regions(self.shift[item], self.covariance[item], self.affine[item], heatmap)

    def repeat(self, count: int) -> "Regions":
        """Regions of one image (1, K) for `count` images, without the heatmap."""
        return Regions(
            self.shift.expand(count, -1, -1),
            self.covariance.expand(count, -1, -1, -1),
            self.affine.expand(count, -1, -1, -1),
        )


def regions_from_motion(shift: Tensor, covariance: Tensor, mode: str = "svd") -> Regions:
    """Regions of given shift (B, K, 2) and covariance (B, K, 2, 2)."""
    return Regions(shift.float(), covariance.float(), affine_from_covariance(covariance, mode))


class RegionEstimator(nn.Module):
    """Unsupervised regions by spatial softmax and its first two moments.

    Args:
        regions: K.
        width: base width of the hourglass.
        blocks: halvings of the hourglass.
        max_width: bound of the hourglass's channels.
        scale: the image is sub-sampled by this first.
        temperature: the logits are divided by it before the softmax.
        padding: of the last 7x7 convolution; 0 makes the heatmap 6 cells smaller.
        covariance_floor: added to the diagonal of every covariance; 0 for released weights.
        affine_mode: as `mraa.affine.affine_from_covariance`.
    """

    def __init__(
        self,
        regions: int = 20,
        width: int = 32,
        blocks: int = 5,
        max_width: int = 1024,
        scale: float = 0.25,
        temperature: float = 0.1,
        padding: int = 0,
        covariance_floor: float = 1e-4,
        affine_mode: str = "svd",
    ) -> None:
        super().__init__()
        self.down = AntiAliasDown(3, scale)
        self.hourglass = Hourglass(3, width, blocks, max_width)
        self.regions = nn.Conv2d(self.hourglass.channels_out, regions, 7, padding=padding)
        self.temperature = temperature
        self.covariance_floor = covariance_floor
        self.affine_mode = affine_mode

    def forward(self, image: Tensor) -> Regions:
        """Regions of images (B, 3, H, W) in [0, 1]."""
        features = self.hourglass(self.down(image))
        with torch.autocast(image.device.type, enabled=False):
            logits = self.regions(features.float())  # rounding would grow by 1 / temperature
            heatmap = torch.softmax(logits.flatten(2) / self.temperature, dim=2)
            heatmap = heatmap.view_as(logits)  # (B, K, h, w)
            shift, covariance = moments(heatmap)
            covariance = covariance + self.covariance_floor * torch.eye(2, device=image.device)
            affine = affine_from_covariance(covariance, self.affine_mode)
        return Regions(shift, covariance, affine, heatmap)


def moments(heatmap: Tensor) -> tuple[Tensor, Tensor]:
    """Mean (B, K, 2) and covariance (B, K, 2, 2) of heatmaps (B, K, h, w) that sum to 1."""
    height, width = heatmap.shape[2:]
    grid = coordinate_grid(height, width, heatmap.device)  # (h, w, 2)
    shift = torch.einsum("bkhw,hwc->bkc", heatmap, grid)
    offset = grid - shift[:, :, None, None]  # (B, K, h, w, 2)
    covariance = torch.einsum("bkhw,bkhwc,bkhwd->bkcd", heatmap, offset, offset)
    return shift, covariance
