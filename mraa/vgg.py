"""Fixed networks that compare pictures: VGG19 from a local file, or a random one."""

from pathlib import Path

import torch
import torch.nn.functional as F
from safetensors.torch import load_file
from torch import Tensor, nn

from data_prep.errors import BadInput


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
        if path.suffix == ".safetensors":
            state = load_file(path)
        else:
            state = torch.load(path, map_location="cpu", weights_only=True)
        given = {k.removeprefix("features."): v for k, v in state.items() if k[:9] == "features."}
        features.load_state_dict(given, assign=True)
    except Exception as error:  # any damaged or foreign file ends here
        raise BadInput(f"{path}: not a VGG19 state dict ({error})") from error
    return Vgg(features)


def random_vgg(width: int = 64, seed: int = 0) -> Vgg:
    """A fixed random VGG with one convolution a group, every tap scaled to unit deviation.

    Random convolutions still compare local structure at several scales; the scaling is done on
    a fixed picture of coloured noise, so that the network follows from `width` and `seed`.

    Args:
        width: channels of the first group; doubled up to 8 times.
        seed: of the weights.
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
