"""Animation via disentanglement: whose shape, which pose (MRAA, section 3.4).

Whose motion goes onto whom: standard, relative, and by disentanglement (MRAA, section 3.4).
"""

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor, nn

from mraa.affine import inverse, relative_affine, renderable, renderable_affine, track_axes
from mraa.regions import Regions, regions_from_motion


def _perceptron(*widths: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for channels_in, channels_out in zip(widths[:-1], widths[1:], strict=True):
        layers += [nn.Linear(channels_in, channels_out), nn.BatchNorm1d(channels_out), nn.ReLU()]
    return nn.Sequential(*layers[:-2])


class AvdNetwork(nn.Module):
    """Regions of one person in the pose of another.

    Args:
        regions: K.
        id_width: numbers that stand for the identity.
        pose_width: numbers that stand for the pose.
        revert_axis_swap: align the identity's affines with the pose's by sign first.
    """

    def __init__(
        self,
        regions: int = 20,
        id_width: int = 64,
        pose_width: int = 64,
        revert_axis_swap: bool = True,
    ) -> None:
        super().__init__()
        numbers = regions * 6  # 2 of the shift, 4 of the affine
        self.id_encoder = _perceptron(numbers, 256, 512, 1024, id_width)
        self.pose_encoder = _perceptron(numbers, 256, 512, 1024, pose_width)
        self.decoder = _perceptron(pose_width + id_width, 1024, 512, 256, numbers)
        self.revert_axis_swap = revert_axis_swap

    def forward(self, identity: Regions, pose: Regions) -> Regions:
        """Regions (B, K) with the shape of `identity` in the pose of `pose`."""
        id_affine = identity.affine
        if self.revert_axis_swap:
            product = relative_affine(identity.affine, pose.affine, revert_axis_swap=False)
            id_affine = id_affine * torch.sign(product[..., :1, :1])
        id_code = self.id_encoder(_flatten(identity.shift, id_affine))
        pose_code = self.pose_encoder(_flatten(pose.shift, pose.affine))
        numbers = self.decoder(torch.cat([pose_code, id_code], dim=1))
        numbers = numbers.view(*identity.shift.shape[:2], 6)  # (B, K, 6)
        shift, affine = numbers[..., :2], numbers[..., 2:].unflatten(-1, (2, 2))
        return Regions(shift, affine @ affine.mT, affine)


def _flatten(shift: Tensor, affine: Tensor) -> Tensor:
    return torch.cat([shift, affine.flatten(-2)], dim=-1).flatten(1)


MODES = ("standard", "relative", "avd")
"""Ways to put a driving video's motion onto a photo."""


def hull_scale(source: Tensor, driving: Tensor) -> float:
    """Ratio of the square roots of the areas that two region sets (K, 2) span.

    Returns 1 where a set is too degenerate to span an area.
    """
    from scipy.spatial import ConvexHull, QhullError  # slow to import, seldom wanted

    try:
        areas = [ConvexHull(x.detach().cpu().numpy()).volume for x in (source, driving)]
    except (QhullError, ValueError):
        return 1.0
    return float(np.sqrt(areas[0]) / np.sqrt(areas[1]))


def relative_regions(source: Regions, driving: Regions, initial: Regions) -> Regions:
    """The driving motion since its first frame, applied to the source.

    `mu = mu_s + scale (mu_d - mu_d0)`, `A = A_d A_d0^-1 A_s`, `C = A A^T`.

    Args:
        source: regions (1, K) of the source image.
        driving: regions (B, K) of driving frames.
        initial: regions (1, K) of the first driving frame.
    """
    scale = hull_scale(source.shift[0], initial.shift[0])
    shift = source.shift + scale * (driving.shift - initial.shift)
    affine = driving.affine @ inverse(initial.affine) @ source.affine
    return Regions(shift, affine @ affine.mT, affine)


def clamped(regions: Regions, affine_mode: str) -> Regions:
    """Estimated regions with covariances clamped to what can be rendered."""
    return regions_from_motion(regions.shift, renderable(regions.covariance), affine_mode)


class Transfer:
    """A driving video's motion, frame by frame in order, onto a source.

    - "standard": the driving regions as they are, for a driver who looks like the source;
    - "relative": what has changed since the first driving frame, `relative_regions`;
    - "avd": the source's body in the driver's pose, by the disentanglement network.

    Args:
        mode: one of `MODES`.
        source: regions (1, K) of the photo as estimated.
        affine_mode: of the renderer.
        avd: the network in evaluation mode, for the mode "avd" alone.
        tracked: follow the axes of regions from frame to frame (`mraa.affine.track_axes`); the
            flow predictor must not revert axes then.
    """

    def __init__(
        self,
        mode: str,
        source: Regions,
        affine_mode: str,
        avd: AvdNetwork | None = None,
        *,
        tracked: bool = False,
    ) -> None:
        if mode not in MODES or (mode == "avd") != (avd is not None):
            raise ValueError(f"mode is one of {', '.join(MODES)}, with the network for avd alone")
        self.mode, self.affine_mode, self.avd, self.tracked = mode, affine_mode, avd, tracked
        self.estimated = source
        self.source = clamped(source, affine_mode)
        self._initial: Regions | None = None
        self._before = self.source.affine[0]

    def __call__(self, driving: Regions) -> Regions:
        """Regions (B, K) to render for the next B driving frames, as estimated."""
        if self.avd is not None:
            moved = self.avd(self.estimated.repeat(len(driving.shift)), driving)
            moved = self._followed(moved)
        elif self.mode == "relative":
            driving = clamped(driving, self.affine_mode)
            if self._initial is None:
                self._initial = driving[:1]
                self._before = self._initial.affine[0]
            moved = relative_regions(self.source, self._followed(driving), self._initial)
        else:
            moved = self._followed(clamped(driving, self.affine_mode))
        affine = renderable_affine(moved.affine)
        return Regions(moved.shift, affine @ affine.mT, affine)

    def _followed(self, regions: Regions) -> Regions:
        if not self.tracked:
            return regions
        affine = track_axes(regions.affine, self._before)
        self._before = affine[-1]
        return replace(regions, affine=affine)
