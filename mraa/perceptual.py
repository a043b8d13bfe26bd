"""How pictures are compared: L1, PSNR, SSIM, and the perceptual loss over an image pyramid.

The perceptual loss sums distances of deep features and of picture bands (MRAA, section 3.5).
"""

from dataclasses import dataclass
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from data_prep.errors import BadInput
from mraa.blocks import AntiAliasDown
from mraa.imagenet import ImagenetDistance, load_imagenet, read_state

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
    from kornia.metrics import ssim as ssim_map  # takes half a second

    if min(image.shape[2:]) < SSIM_SIZE:
        raise ValueError("SSIM wants images of at least 11x11 pixels")
    with torch.autocast(image.device.type, enabled=False):
        similarity = ssim_map(image.float(), truth.float(), SSIM_SIZE, 1.0, padding="valid")
    return similarity.flatten(1).mean(1)


class Vgg(nn.Module):
    """A VGG's features, tapped after the first ReLU of every group (of VGG19: relu1_1 to relu5_1).

    Frozen. Images are normalised as torchvision's networks want them.

    Args:
        features: convolutions, ReLUs and max poolings in order, such as torchvision's.
    """

    mean: Tensor
    std: Tensor

    def __init__(self, features: nn.Sequential) -> None:
        super().__init__()
        layers = list(features)
        poolings = [i for i, layer in enumerate(layers) if isinstance(layer, nn.MaxPool2d)]
        taps = [2, *(i + 3 for i in poolings if i + 3 <= len(layers))]  # behind conv and ReLU
        cuts = zip([0, *taps[:-1]], taps, strict=True)
        self.blocks = nn.ModuleList(nn.Sequential(*layers[a:b]) for a, b in cuts)
        self.register_buffer("mean", torch.tensor([0.485, 0.456, 0.406]).view(1, 3, 1, 1))
        self.register_buffer("std", torch.tensor([0.229, 0.224, 0.225]).view(1, 3, 1, 1))
        self.requires_grad_(False)

    def forward(self, image: Tensor) -> list[Tensor]:
        """Five feature maps of images (B, 3, H, W) in [0, 1]; too small ones give fewer."""
        x = (image - self.mean) / self.std
        taps: list[Tensor] = []
        for block in self.blocks:
            if taps and min(x.shape[2:]) < 2:
                break
            x = block(x)
            taps.append(x)
        return taps


def load_vgg19(path: Path) -> Vgg:
    """VGG19 from a local file of torchvision's `vgg19` state dict (.pth or .safetensors).

    Raises:
        BadInput: missing, unreadable, or not VGG19's tensors.
    """
    from torchvision.models import vgg19  # takes a second

    path = Path(path)
    if not path.is_file():
        raise BadInput(f"{path}: no such file; leave perceptual_weights empty to do without")
    with torch.device("meta"):  # neither memory nor time for weights that the file replaces
        features = vgg19().features
    try:
        state = read_state(path).items()
        given = {k.removeprefix("features."): v for k, v in state if k[:9] == "features."}
        features.load_state_dict(given, assign=True)
    except BadInput:
        raise
    except Exception as error:  # any damaged or foreign file ends here
        raise BadInput(f"{path}: not a VGG19 state dict ({error})") from error
    return Vgg(features)


def random_vgg(width: int = 64, seed: int = 0) -> Vgg:
    """A fixed random VGG with one convolution a group, every tap scaled to unit deviation.

    Random convolutions still compare local structure at several scales; the scaling is done on
    a fixed picture of coloured noise, so that the network follows from `width` and `seed`.

    `width`: channels of the first group; doubled up to 8 times.
    """
    generator = torch.Generator().manual_seed(seed)
    widths = [3, *(min(width * 2**i, 8 * width) for i in range(5))]
    layers: list[nn.Module] = []
    for before, after in zip(widths, widths[1:], strict=False):
        layers += [nn.Conv2d(before, after, 3, padding=1), nn.ReLU(), nn.MaxPool2d(2)]
    vgg = Vgg(nn.Sequential(*layers))
    noise = torch.rand(1, 3, 256, 256, generator=generator)
    smooth = F.interpolate(
        torch.rand(1, 3, 16, 16, generator=generator), size=256, mode="bicubic"
    ).clamp(0, 1)
    x = (0.2 * noise + 0.8 * smooth - vgg.mean) / vgg.std
    with torch.no_grad():
        for block in vgg.blocks:
            conv = next(layer for layer in block.children() if isinstance(layer, nn.Conv2d))
            weight = torch.randn(conv.weight.shape, generator=generator)
            conv.weight.copy_(weight - weight.mean(dim=(1, 2, 3), keepdim=True) * 0.5)
            nn.init.zeros_(conv.bias)  # type: ignore[arg-type]
            conv.weight.div_(block(x).std())
            x = block(x)
    return vgg


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


BACKENDS = ("vgg19", "random_vgg", "lap", "random_vgg+lap", "imagenet", "imagenet+lap")
"""What can compare two pictures: VGG19 of a local file (MRAA), a fixed random network, a Laplacian
pyramid with SSIM, EfficientNet-Lite0 (`mraa.imagenet`), or a network and the pyramid."""


OFFLINE = "random_vgg+lap"
"""The backend where no weights file is given."""


IMAGENET_SIZE = 64
"""Pixels of the smallest pictures that EfficientNet-Lite0 compares."""


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
    without it. "imagenet": `weight * sum over scales of ImagenetDistance`, whose gradients at the
    picture are about as large as those of the random network.

    Args:
        backend: one of `BACKENDS`, or "auto" for VGG19 where `weights` is given, else `OFFLINE`.
        weights: path of VGG19's state dict, for "vgg19"; for "imagenet" of EfficientNet-Lite0's,
            where its package is not installed.
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
        self.natural: ImagenetDistance | None = None
        if "imagenet" in self.backend:
            self.natural = ImagenetDistance(load_imagenet(Path(weights) if weights else None))
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
            if scale not in self.scales:
                continue
            if self.vgg is not None:
                total = total + self._deep(small, wanted)
            if self.natural is not None and min(small.shape[2:]) >= IMAGENET_SIZE:
                total = total + self.natural(small, wanted)
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
