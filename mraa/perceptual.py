"""Perceptual loss: deep features and picture bands over an image pyramid (MRAA, section 3.5)."""

from pathlib import Path

import torch
from torch import Tensor, nn

from mraa.image_metrics import SSIM_SIZE, ssim
from mraa.pyramid import PYRAMID_SCALES, ImagePyramid, laplacian_distance
from mraa.vgg import load_vgg19, random_vgg

BACKENDS = ("vgg19", "random_vgg", "lap", "random_vgg+lap")
"""What can compare two pictures: VGG19 of a local file (MRAA), a fixed random network, a Laplacian
pyramid with SSIM, or both of the latter."""

OFFLINE = "random_vgg+lap"
"""The backend where no weights file is given."""

BANDS_WEIGHT = 4.0
"""Of the Laplacian pyramid's L1 beside one layer of deep features and beside 1 - SSIM."""


def backend_of(backend: str, weights: str) -> str:
    """The backend that a setting ("auto" or one of `BACKENDS`) and a weights file mean."""
    if backend == "auto":
        return "vgg19" if weights else OFFLINE
    return backend


class PerceptualPyramid(nn.Module):
    """Weighted distance of pictures over an image pyramid.

    Deep features: `sum over scales and layers of weight * mean |phi(prediction) - phi(truth)|`,
    with VGG19 (MRAA) or the fixed random network. "lap": `weight * (4 * sum over bands of
    mean |band(prediction) - band(truth)| + 1 - SSIM)`; pictures smaller than SSIM's window do
    without it.

    Args:
        backend: one of `BACKENDS`, or "auto" for VGG19 where `weights` is given, else `OFFLINE`.
        weights: path of VGG19's state dict, for "vgg19".
        width: of the random network.
        scales: resolutions at which deep features are compared.
        weight: of the whole.
    """

    def __init__(
        self,
        backend: str = "auto",
        weights: str = "",
        width: int = 32,
        scales: tuple[float, ...] = PYRAMID_SCALES,
        weight: float = 10.0,
    ) -> None:
        super().__init__()
        self.backend = backend_of(backend, weights)
        if self.backend not in BACKENDS:
            raise ValueError(f"perceptual backend {backend}: there are auto, {', '.join(BACKENDS)}")
        self.vgg: nn.Module | None = None
        if self.backend == "vgg19":
            self.vgg = load_vgg19(Path(weights))
        elif "random_vgg" in self.backend:
            self.vgg = random_vgg(width)
        self.bands = "lap" in self.backend
        self.pyramid = ImagePyramid()
        self.scales = scales
        self.weight = weight
        self.requires_grad_(False)

    def forward(self, prediction: Tensor, truth: Tensor) -> Tensor:
        """Scalar loss of images (B, 3, H, W) in [0, 1]."""
        predictions, truths = self.pyramid(prediction), self.pyramid(truth)
        total = prediction.new_zeros((), dtype=torch.float32)
        for scale, small, wanted in zip(PYRAMID_SCALES, predictions, truths, strict=True):
            if self.vgg is not None and scale in self.scales:
                total = total + self._deep(small, wanted)
        if self.bands:
            total = total + bands_distance(predictions, truths)
        return self.weight * total

    def _deep(self, image: Tensor, truth: Tensor) -> Tensor:
        """Sum over layers of the mean distance of deep features."""
        assert self.vgg is not None
        with torch.no_grad():
            wanted = self.vgg(truth)
        terms = [(a - b).abs().float().mean() for a, b in zip(self.vgg(image), wanted, strict=True)]
        return torch.stack(terms).sum()


def bands_distance(predictions: list[Tensor], truths: list[Tensor]) -> Tensor:
    """Distance "lap" of two pyramids: L1 of the bands, and 1 - SSIM of the pictures themselves."""
    total = BANDS_WEIGHT * laplacian_distance(predictions, truths)
    if min(truths[0].shape[2:]) >= SSIM_SIZE:
        total = total + 1 - ssim(predictions[0], truths[0]).mean()
    return total
