"""Distances between pictures: L1, PSNR, SSIM and the perceptual pyramid, one number a picture."""

from dataclasses import dataclass
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from mraa.pyramid import ImagePyramid
from mraa.vgg import load_vgg19, random_vgg

SSIM_SIGMA = 1.5
"""Standard deviation of SSIM's window in pixels."""

SSIM_SIZE = 11
"""Side of SSIM's window in pixels."""

PERCEPTUAL_WEIGHT = 10.0
"""Of every scale and layer of the perceptual distance, as in MRAA's loss."""


def l1(image: Tensor, truth: Tensor) -> Tensor:
    """Mean absolute error (B,) of images (B, C, H, W) in [0, 1]."""
    return (image - truth).abs().flatten(1).mean(1)


def psnr(image: Tensor, truth: Tensor) -> Tensor:
    """Peak signal-to-noise ratio (B,) in decibels of images (B, C, H, W) in [0, 1].

    That of each image's mean squared error over all channels, whose mean over images is what
    reports state. Equal images give 100 dB, the most there is.
    """
    error = ((image - truth) ** 2).flatten(1).mean(1)
    return -10 * torch.log10(error.clamp_min(1e-10))


def ssim(image: Tensor, truth: Tensor) -> Tensor:
    """Structural similarity (B,) of images (B, C, H, W) in [0, 1], differentiable.

    As Wang et al., *Image Quality Assessment: From Error Visibility to Structural Similarity*,
    2004: Gaussian window of 11x11 pixels and sigma 1.5, K1 = 0.01, K2 = 0.03, dynamic range 1,
    windows that lie wholly inside the image; on every colour channel by itself, then their mean.
    scikit-image gives the same with `gaussian_weights=True, use_sample_covariance=False,
    data_range=1, channel_axis=...`.

    Raises:
        ValueError: images smaller than the window.
    """
    if min(image.shape[2:]) < SSIM_SIZE:
        raise ValueError("SSIM wants images of at least 11x11 pixels")
    count = image.shape[1]
    both = torch.cat([image, truth, image * image, truth * truth, image * truth], dim=1).float()
    a, b, aa, bb, ab = _window_means(both).split(count, dim=1)
    c1, c2 = 0.01**2, 0.03**2
    covariance, variances = ab - a * b, aa - a * a + bb - b * b
    map_ = (2 * a * b + c1) * (2 * covariance + c2)
    map_ = map_ / ((a * a + b * b + c1) * (variances + c2))
    return map_.flatten(1).mean(1)


def _window_means(x: Tensor) -> Tensor:
    """Gaussian means of (B, C, H, W) around every pixel whose window lies inside."""
    channels = x.shape[1]
    offsets = torch.arange(SSIM_SIZE, dtype=torch.float32, device=x.device) - SSIM_SIZE // 2
    line = torch.exp(-(offsets**2) / (2 * SSIM_SIGMA**2))
    line = (line / line.sum()).repeat(channels, 1, 1, 1)  # (C, 1, 1, 11)
    with torch.autocast(x.device.type, enabled=False):
        x = F.conv2d(x, line, groups=channels)
        return F.conv2d(x, line.mT, groups=channels)


class PerceptualDistance(nn.Module):
    """Weighted pyramid sum of deep features, a distance in which lower is better.

    `sum over scales 1, 1/2, 1/4, 1/8 and five layers of 10 * mean |phi(image) - phi(truth)|`: the
    perceptual loss of MRAA (section 3.5), which ANGIE's "perceptual" figures have the size of.
    With VGG19 where its weights are at hand, else with a fixed random network of one width,
    whatever a renderer was trained with. Figures of two backends cannot be compared: state
    `backend` beside every figure.

    Args:
        weights: file of torchvision's `vgg19` state dict; empty for the random network.
    """

    def __init__(self, weights: str = "") -> None:
        super().__init__()
        self.backend = "vgg19" if weights else "random_vgg"
        self.vgg = load_vgg19(Path(weights)) if weights else random_vgg(32)
        self.pyramid = ImagePyramid()

    @torch.no_grad()
    def forward(self, image: Tensor, truth: Tensor) -> Tensor:
        """Distance (B,) of images (B, 3, H, W) in [0, 1]."""
        total = image.new_zeros(len(image))
        for small, wanted in zip(self.pyramid(image), self.pyramid(truth), strict=True):
            for a, b in zip(self.vgg(small), self.vgg(wanted), strict=True):
                total = total + PERCEPTUAL_WEIGHT * l1(a, b)
        return total


@dataclass(frozen=True)
class ImageScores:
    """Distances of images to their truths, (B,) each."""

    l1: Tensor
    """Mean absolute error in [0, 1]."""
    psnr: Tensor
    """Decibels."""
    ssim: Tensor
    """At most 1."""
    perceptual: Tensor
    """As `PerceptualDistance`."""


def score(image: Tensor, truth: Tensor, perceptual: PerceptualDistance) -> ImageScores:
    """All distances of images (B, 3, H, W) in [0, 1] to `truth`."""
    return ImageScores(
        l1(image, truth), psnr(image, truth), ssim(image, truth), perceptual(image, truth)
    )
