"""Convolutional encoder and decoder over time, shared by generators that quantise motion."""

from torch import Tensor, nn

from data_prep.rates import FRAMES_PER_TOKEN

DILATIONS = (1, 3, 9)


HALVINGS = FRAMES_PER_TOKEN.bit_length() - 1
"""Strided convolutions that make one token of 8 frames."""


class ResidualBlock(nn.Module):
    """x + conv1(relu(conv3 of a dilation(relu(x)))), no normalisation."""

    def __init__(self, width: int, dilation: int) -> None:
        super().__init__()
        self.wide = nn.Conv1d(width, width, 3, padding=dilation, dilation=dilation)
        self.narrow = nn.Conv1d(width, width, 1)

    def forward(self, values: Tensor) -> Tensor:
        """(B, W, T) to the same shape."""
        return values + self.narrow(self.wide(values.relu()).relu())


class Encoder(nn.Module):
    """Deltas (B, T, C) to latent vectors (B, T // 8, code_width)."""

    def __init__(self, channels: int, width: int, code_width: int) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for stage in range(HALVINGS):
            layers.append(nn.Conv1d(width if stage else channels, width, 4, stride=2, padding=1))
            layers.extend(ResidualBlock(width, dilation) for dilation in DILATIONS)
        self.layers = nn.Sequential(*layers, nn.Conv1d(width, code_width, 3, padding=1))

    def forward(self, deltas: Tensor) -> Tensor:
        """Encode; frames beyond a multiple of 8 are not seen."""
        length = deltas.shape[1] // FRAMES_PER_TOKEN * FRAMES_PER_TOKEN
        return self.layers(deltas[:, :length].mT).mT


class Decoder(nn.Module):
    """Latent vectors (B, S, code_width) to deltas (B, 8S, C)."""

    def __init__(self, channels: int, width: int, code_width: int) -> None:
        super().__init__()
        layers: list[nn.Module] = [nn.Conv1d(code_width, width, 3, padding=1)]
        for _ in range(HALVINGS):
            layers.extend(ResidualBlock(width, dilation) for dilation in reversed(DILATIONS))
            layers.append(nn.ConvTranspose1d(width, width, 4, stride=2, padding=1))
        self.layers = nn.Sequential(*layers, nn.Conv1d(width, channels, 3, padding=1))

    def forward(self, latent: Tensor) -> Tensor:
        """Decode."""
        return self.layers(latent.mT).mT
