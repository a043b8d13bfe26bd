"""Convolution blocks of MRAA: down, up, same, residual, hourglass, anti-aliased down-sampling."""

import math

import torch
import torch.nn.functional as F
from torch import Tensor, nn


class DownBlock(nn.Module):
    """3x3 convolution, batch norm, ReLU, 2x2 average pooling: (B, C, H, W) to half the size."""

    def __init__(self, channels_in: int, channels_out: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(channels_in, channels_out, 3, padding=1)
        self.norm = nn.BatchNorm2d(channels_out)

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) to (B, C', H/2, W/2)."""
        return F.avg_pool2d(F.relu(self.norm(self.conv(x))), 2)


class UpBlock(nn.Module):
    """Nearest doubling, 3x3 convolution, batch norm, ReLU."""

    def __init__(self, channels_in: int, channels_out: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(channels_in, channels_out, 3, padding=1)
        self.norm = nn.BatchNorm2d(channels_out)

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) to (B, C', 2H, 2W)."""
        return F.relu(self.norm(self.conv(F.interpolate(x, scale_factor=2.0))))


class SameBlock(nn.Module):
    """Convolution of odd size, batch norm, ReLU, at the same resolution."""

    def __init__(self, channels_in: int, channels_out: int, kernel: int = 3) -> None:
        super().__init__()
        self.conv = nn.Conv2d(channels_in, channels_out, kernel, padding=kernel // 2)
        self.norm = nn.BatchNorm2d(channels_out)

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) to (B, C', H, W)."""
        return F.relu(self.norm(self.conv(x)))


class ResBlock(nn.Module):
    """Pre-activation residual block (MRAA): BN-ReLU-conv-BN-ReLU-conv plus identity."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(channels, channels, 3, padding=1)
        self.conv2 = nn.Conv2d(channels, channels, 3, padding=1)
        self.norm1 = nn.BatchNorm2d(channels)
        self.norm2 = nn.BatchNorm2d(channels)

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) to the same shape."""
        y = self.conv1(F.relu(self.norm1(x)))
        return x + self.conv2(F.relu(self.norm2(y)))


class PostResBlock(nn.Module):
    """Post-activation residual block: conv-BN-ReLU-conv-BN plus identity, ReLU.

    Every norm follows a convolution, so that it folds into it at inference.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(channels, channels, 3, padding=1)
        self.conv2 = nn.Conv2d(channels, channels, 3, padding=1)
        self.norm1 = nn.BatchNorm2d(channels)
        self.norm2 = nn.BatchNorm2d(channels)

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) to the same shape."""
        y = F.relu(self.norm1(self.conv1(x)))
        return F.relu(x + self.norm2(self.conv2(y)))


class Encoder(nn.Module):
    """Down half of the hourglass; block i has `min(max_width, width * 2^(i+1))` channels."""

    def __init__(self, channels_in: int, width: int, blocks: int, max_width: int) -> None:
        super().__init__()
        widths = [channels_in] + [min(max_width, width * 2 ** (i + 1)) for i in range(blocks)]
        self.down_blocks = nn.ModuleList(
            DownBlock(a, b) for a, b in zip(widths[:-1], widths[1:], strict=True)
        )

    def forward(self, x: Tensor) -> list[Tensor]:
        """(B, C, H, W) to the features of every resolution, the input first."""
        features = [x]
        for block in self.down_blocks:
            features.append(block(features[-1]))
        return features


class Decoder(nn.Module):
    """Up half of the hourglass with a skip after every block, the raw input last."""

    def __init__(self, channels_in: int, width: int, blocks: int, max_width: int) -> None:
        super().__init__()
        ups = []
        for i in reversed(range(blocks)):
            incoming = min(max_width, width * 2 ** (i + 1)) * (1 if i == blocks - 1 else 2)
            ups.append(UpBlock(incoming, min(max_width, width * 2**i)))
        self.up_blocks = nn.ModuleList(ups)
        self.channels_out = width + channels_in

    def forward(self, features: list[Tensor]) -> Tensor:
        """Features of `Encoder` to (B, width + C, H, W)."""
        x = features[-1]
        for block, skip in zip(self.up_blocks, reversed(features[:-1]), strict=True):
            x = torch.cat([block(x), skip], dim=1)
        return x


class Hourglass(nn.Module):
    """Encoder and decoder (MRAA): (B, C, H, W) to (B, width + C, H, W).

    Args:
        channels_in: C.
        width: channels before the first doubling ("block expansion").
        blocks: halvings; H and W must be multiples of `2**blocks`.
        max_width: bound of the channels.
    """

    def __init__(self, channels_in: int, width: int, blocks: int, max_width: int) -> None:
        super().__init__()
        self.encoder = Encoder(channels_in, width, blocks, max_width)
        self.decoder = Decoder(channels_in, width, blocks, max_width)
        self.channels_out = self.decoder.channels_out

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) to (B, width + C, H, W)."""
        return self.decoder(self.encoder(x))


def gaussian_kernel(scale: float) -> Tensor:
    """Low-pass kernel before sub-sampling by `scale` < 1: sigma (1/scale - 1) / 2, sums to 1.

    Returns:
        (k, k) float32 with k = 2 round(4 sigma) + 1.
    """
    sigma = (1 / scale - 1) / 2
    size = 2 * round(4 * sigma) + 1
    offsets = torch.arange(size, dtype=torch.float32) - (size - 1) / 2
    line = torch.exp(-(offsets**2) / (2 * sigma**2))
    kernel = line[:, None] * line[None, :]
    return kernel / kernel.sum()


class AntiAliasDown(nn.Module):
    """Gaussian low-pass with zero padding, then every `1/scale`-th pixel (float32).

    Args:
        channels: channels of the image.
        scale: 1 over a whole number; 1 is the identity and has no kernel.
    """

    kernel: Tensor

    def __init__(self, channels: int, scale: float) -> None:
        super().__init__()
        self.step = round(1 / scale)
        if not math.isclose(self.step * scale, 1, rel_tol=1e-6):
            raise ValueError(f"scale {scale} is not 1 over a whole number")
        self.channels = channels
        if self.step > 1:
            kernel = gaussian_kernel(1 / self.step)
            self.register_buffer("kernel", kernel[None, None].repeat(channels, 1, 1, 1))

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) to (B, C, H * scale, W * scale)."""
        if self.step == 1:
            return x
        with torch.autocast(x.device.type, enabled=False):
            return F.conv2d(
                x.float(),
                self.kernel,
                stride=self.step,
                padding=self.kernel.shape[-1] // 2,
                groups=self.channels,
            )
