"""Fixed networks that compare pictures: VGG19 from a local file, or a random one."""

from pathlib import Path

import torch
import torch.nn.functional as F
from safetensors.torch import load_file
from torch import Tensor, nn

from data_prep.errors import BadInput

VGG19_CONVS = (2, 2, 4, 4, 4)
"""Convolutions before each max pooling of VGG19."""

VGG19_WIDTHS = (64, 128, 256, 512, 512)
"""Channels of the five groups of convolutions of VGG19."""


class Vgg(nn.Module):
    """VGG19 up to relu5_1; taps after relu1_1, relu2_1, relu3_1, relu4_1, relu5_1. Frozen.

    Args:
        widths: channels of the five groups; the default is VGG19's.
        convs: convolutions of the first four groups (of the fifth only the first is used).
    """

    mean: Tensor
    std: Tensor

    def __init__(
        self,
        widths: tuple[int, ...] = VGG19_WIDTHS,
        convs: tuple[int, ...] = VGG19_CONVS,
    ) -> None:
        super().__init__()
        channels = 3
        self.groups: list[list[nn.Conv2d]] = []
        for width, count in zip(widths, (*convs[:-1], 1), strict=True):
            group = []
            for _ in range(count):
                group.append(nn.Conv2d(channels, width, 3, padding=1))
                channels = width
            self.groups.append(group)
        self.convs = nn.ModuleList(conv for group in self.groups for conv in group)
        self.register_buffer("mean", torch.tensor([0.485, 0.456, 0.406]).view(1, 3, 1, 1))
        self.register_buffer("std", torch.tensor([0.229, 0.224, 0.225]).view(1, 3, 1, 1))
        self.requires_grad_(False)

    def forward(self, image: Tensor) -> list[Tensor]:
        """Five feature maps of images (B, 3, H, W) in [0, 1]; too small ones give fewer."""
        x = (image - self.mean) / self.std
        taps = []
        for index, group in enumerate(self.groups):
            if index:
                if min(x.shape[2:]) < 2:
                    break
                x = F.max_pool2d(x, 2)
            for number, conv in enumerate(group):
                x = F.relu(conv(x))
                if number == 0:
                    taps.append(x)
        return taps


def load_vgg19(path: Path) -> Vgg:
    """VGG19 from a local file of torchvision's `vgg19` state dict (.pth or .safetensors).

    Raises:
        BadInput: missing, unreadable, or not VGG19's tensors.
    """
    path = Path(path)
    if not path.is_file():
        raise BadInput(f"{path}: no such file; leave perceptual_weights empty to do without")
    try:
        if path.suffix == ".safetensors":
            state = load_file(path)
        else:
            state = torch.load(path, map_location="cpu", weights_only=True)
        vgg = Vgg()
        position = 0  # index in torchvision's flat `features`
        for index, group in enumerate(vgg.groups):
            for number, conv in enumerate(group):
                at = position + 2 * number
                conv.load_state_dict(
                    {name: state[f"features.{at}.{name}"] for name in ("weight", "bias")}
                )
            position += 2 * VGG19_CONVS[index] + 1
    except Exception as error:  # any damaged or foreign file ends here
        raise BadInput(f"{path}: not a VGG19 state dict ({error})") from error
    return vgg


def random_vgg(width: int = 64, seed: int = 0) -> Vgg:
    """A fixed random VGG with one convolution a group, every tap scaled to unit deviation.

    Random convolutions still compare local structure at several scales; the scaling is done on
    a fixed picture of coloured noise, so that the network follows from `width` and `seed`.

    Args:
        width: channels of the first group; doubled up to 8 times.
        seed: of the weights.
    """
    generator = torch.Generator().manual_seed(seed)
    vgg = Vgg(tuple(min(width * 2**i, 8 * width) for i in range(5)), (1, 1, 1, 1, 1))
    noise = torch.rand(1, 3, 256, 256, generator=generator)
    smooth = F.interpolate(
        torch.rand(1, 3, 16, 16, generator=generator), size=256, mode="bicubic"
    ).clamp(0, 1)
    x = (0.2 * noise + 0.8 * smooth - vgg.mean) / vgg.std
    with torch.no_grad():
        for index, group in enumerate(vgg.groups):
            conv = group[0]
            weight = torch.randn(conv.weight.shape, generator=generator)
            conv.weight.copy_(weight - weight.mean(dim=(1, 2, 3), keepdim=True) * 0.5)
            nn.init.zeros_(conv.bias)  # type: ignore[arg-type]
            x = F.max_pool2d(x, 2) if index else x
            conv.weight.div_(F.relu(conv(x)).std())
            x = F.relu(conv(x))
    return vgg
