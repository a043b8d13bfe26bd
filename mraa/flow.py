"""Pixel-wise flow predictor: regions of source and driving to flow and occlusion (MRAA).

Background motion predictor: the camera's motion between two frames (MRAA, section 3).
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from mraa.affine import inverse, relative_affine
from mraa.blocks import AntiAliasDown, Encoder, Hourglass
from mraa.grid import coordinate_grid, resize_flow, warp
from mraa.regions import Regions


@dataclass(frozen=True)
class Flow:
    """Where each pixel of the new frame comes from, at the flow predictor's resolution."""

    flow: Tensor
    """(B, h, w, 2) float32 source coordinates (x, y) in [-1, 1]."""
    occlusion: Tensor
    """(B, 1, h, w) float32 in [0, 1]; 1 where the source shows what is needed."""
    masks: Tensor
    """(B, K + 1, h, w) float32, sums to 1 over regions; index 0 is the background."""
    blend: Tensor
    """(B, 3, h, w) float32, the small source deformed by every region and blended by the masks."""
    features: Tensor
    """(B, C, h, w), what masks and occlusion are made of: both poses and the deformed sources."""


def region_heatmap(regions: Regions, height: int, width: int) -> Tensor:
    """Unnormalised Gaussians `exp(-0.5 (z-mu)^T C^-1 (z-mu))`: (B, K, height, width)."""
    grid = coordinate_grid(height, width, regions.shift.device)
    offset = grid - regions.shift[:, :, None, None]  # (B, K, h, w, 2)
    x, y = offset.unbind(-1)
    precision = inverse(regions.covariance)[:, :, None, None]  # (B, K, 1, 1, 2, 2)
    xx, xy, yy = precision[..., 0, 0], precision[..., 0, 1], precision[..., 1, 1]
    return torch.exp(-0.5 * (xx * x * x + 2 * xy * x * y + yy * y * y))


def region_maps(
    source: Regions, driving: Regions, *, revert_axis_swap: bool
) -> tuple[Tensor, Tensor]:
    """Motion of each region, `z -> M z + t` with `M = A_s A_d^-1` and `t = mu_s - M mu_d`.

    Args:
        source: regions of the source.
        driving: regions of the driving frame.
        revert_axis_swap: as `mraa.affine.relative_affine`.

    Returns:
        (B, K, 2, 2) and (B, K, 2), from driving to source coordinates.
    """
    matrix = relative_affine(source.affine, driving.affine, revert_axis_swap=revert_axis_swap)
    return matrix, source.shift - (matrix @ driving.shift[..., None])[..., 0]


def sparse_motions(
    source: Regions,
    driving: Regions,
    height: int,
    width: int,
    *,
    background: Tensor | None,
    revert_axis_swap: bool,
) -> Tensor:
    """Motion of each region as a full field: `z -> mu_s + A_s A_d^-1 (z - mu_d)`.

    Args:
        source: regions of the source.
        driving: regions of the driving frame.
        height: rows of the field.
        width: columns of the field.
        background: (B, 3, 3) homographies; None is the identity.
        revert_axis_swap: as `mraa.affine.relative_affine`.

    Returns:
        (B, K + 1, height, width, 2) source coordinates; index 0 is the background.
    """
    grid = coordinate_grid(height, width, driving.shift.device)
    matrix, offset = region_maps(source, driving, revert_axis_swap=revert_axis_swap)
    moved = torch.einsum("bkij,hwj->bkhwi", matrix, grid) + offset[:, :, None, None]
    still = grid.expand(len(moved), 1, height, width, 2)
    if background is not None:
        homogeneous = torch.cat([grid, torch.ones_like(grid[..., :1])], dim=-1)
        mapped = torch.einsum("bij,hwj->bhwi", background, homogeneous)
        still = (mapped[..., :2] / mapped[..., 2:])[:, None]
    return torch.cat([still, moved], dim=1)


def deform(image: Tensor, flow: Flow, *, align_corners: bool) -> Tensor:
    """The image (B, C, H, W) as the flow alone deforms it."""
    field = resize_flow(flow.flow, *image.shape[2:], align_corners=align_corners)
    return warp(image, field, align_corners=align_corners)


class FlowPredictor(nn.Module):
    """Blend of the regions' motions by predicted masks, and the occlusion map.

    Args:
        regions: K.
        width: base width of the hourglass.
        blocks: halvings of the hourglass.
        max_width: bound of the hourglass's channels.
        scale: the source is sub-sampled by this first.
        align_corners: grid convention of the warps.
        revert_axis_swap: as `mraa.affine.relative_affine`.
    """

    def __init__(
        self,
        regions: int = 20,
        width: int = 64,
        blocks: int = 5,
        max_width: int = 1024,
        scale: float = 0.25,
        align_corners: bool = True,
        revert_axis_swap: bool = True,
    ) -> None:
        super().__init__()
        self.down = AntiAliasDown(3, scale)
        self.hourglass = Hourglass((regions + 1) * 4, width, blocks, max_width)
        self.mask = nn.Conv2d(self.hourglass.channels_out, regions + 1, 7, padding=3)
        self.occlusion = nn.Conv2d(self.hourglass.channels_out, 1, 7, padding=3)
        self.align_corners = align_corners
        self.revert_axis_swap = revert_axis_swap

    def forward(
        self,
        source: Tensor,
        source_regions: Regions,
        driving_regions: Regions,
        background: Tensor | None = None,
    ) -> Flow:
        """Flow from source images (B, 3, H, W) in [0, 1] and the regions of both frames."""
        return self.from_small(self.down(source), source_regions, driving_regions, background)

    def from_small(
        self,
        small: Tensor,
        source_regions: Regions,
        driving_regions: Regions,
        background: Tensor | None = None,
    ) -> Flow:
        """As `forward`, from sources that `down` made small, (B, 3, h, w)."""
        with torch.autocast(small.device.type, enabled=False):
            batch, _, height, width = small.shape
            motions = sparse_motions(
                source_regions,
                driving_regions,
                height,
                width,
                background=background,
                revert_axis_swap=self.revert_axis_swap,
            )
            count = motions.shape[1]  # K + 1
            difference = region_heatmap(driving_regions, height, width) - region_heatmap(
                source_regions, height, width
            )
            heatmap = torch.cat([torch.zeros_like(difference[:, :1]), difference], dim=1)
            copies = small[:, None].expand(-1, count, -1, -1, -1).flatten(0, 1)
            deformed = warp(copies, motions.flatten(0, 1), align_corners=self.align_corners)
            deformed = deformed.view(batch, count, 3, height, width)
            stack = torch.cat([heatmap[:, :, None], deformed], dim=2).flatten(1, 2)
        features = self.hourglass(stack)
        mask_logits, occlusion_logits = self.mask(features), self.occlusion(features)
        with torch.autocast(small.device.type, enabled=False):
            masks = torch.softmax(mask_logits.float(), dim=1)
            flow = torch.einsum("bkhw,bkhwc->bhwc", masks, motions)
            blend = torch.einsum("bkhw,bkchw->bchw", masks, deformed)
            occlusion = torch.sigmoid(occlusion_logits.float())
            return Flow(flow, occlusion, masks, blend, features)


PARAMETERS = {"zero": 0, "shift": 2, "affine": 6, "perspective": 8}
"""Numbers that each kind of background motion has."""


class BackgroundPredictor(nn.Module):
    """A 3x3 homography of background coordinates, driving to source.

    Args:
        kind: "zero" (identity), "shift", "affine" (MRAA's configurations) or "perspective".
        width: base width of the encoder.
        blocks: halvings of the encoder.
        max_width: bound of the channels.
        scale: the images are sub-sampled by this first; 1 in MRAA.
    """

    def __init__(
        self,
        kind: str = "affine",
        width: int = 32,
        blocks: int = 5,
        max_width: int = 1024,
        scale: float = 1.0,
    ) -> None:
        super().__init__()
        self.kind = kind
        if kind == "zero":
            return
        self.down = AntiAliasDown(6, scale)
        self.encoder = Encoder(6, width, blocks, max_width)
        self.fc = nn.Linear(min(max_width, width * 2**blocks), PARAMETERS[kind])
        nn.init.zeros_(self.fc.weight)
        identity = {
            "shift": [0, 0],
            "affine": [1, 0, 0, 0, 1, 0],
            "perspective": [1, 0, 0, 0, 1, 0, 0, 0],
        }[kind]
        with torch.no_grad():
            self.fc.bias.copy_(torch.tensor(identity, dtype=torch.float32))

    def forward(self, source: Tensor, driving: Tensor) -> Tensor:
        """Homographies (B, 3, 3) float32 from images (B, 3, H, W) in [0, 1]."""
        matrix = torch.eye(3, device=source.device).repeat(len(source), 1, 1)
        if self.kind == "zero":
            return matrix
        features = self.encoder(self.down(torch.cat([source, driving], dim=1)))[-1]
        with torch.autocast(features.device.type, enabled=False):  # bfloat16 has no 1.003
            numbers = self.fc(features.float().mean(dim=(2, 3)))  # (B, 2 | 6 | 8)
        if self.kind == "shift":
            matrix[:, :2, 2] = numbers
        elif self.kind == "affine":
            matrix[:, :2, :] = numbers.view(-1, 2, 3)
        else:
            ones = torch.ones_like(numbers[:, :1])
            matrix = torch.cat([numbers, ones], dim=1).view(-1, 3, 3)
        return matrix
