"""Background motion predictor: the camera's motion between two frames (MRAA, section 3)."""

import torch
from torch import Tensor, nn

from mraa.blocks import AntiAliasDown, Encoder

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
