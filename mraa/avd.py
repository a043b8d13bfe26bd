"""Animation via disentanglement: whose shape, which pose (MRAA, section 3.4)."""

import torch
from torch import Tensor, nn

from mraa.affine import relative_affine
from mraa.regions import Regions


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
