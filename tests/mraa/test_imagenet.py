"""The network that knows natural pictures, and the distance in its features."""

import pytest
import torch

from data_prep.errors import BadInput
from mraa.imagenet import (
    TAPS,
    EfficientNetLite,
    ImagenetDistance,
    converted,
    installed,
    load_imagenet,
)
from mraa.perceptual import PerceptualPyramid

needs_weights = pytest.mark.skipif(installed() is None, reason="angie[perceptual] is missing")


@pytest.fixture
def images():
    """Two smooth pictures (1, 3, 64, 64) in [0, 1]."""
    random = torch.Generator().manual_seed(0)
    small = torch.rand(2, 3, 8, 8, generator=random)
    large = torch.nn.functional.interpolate(small, size=64, mode="bicubic").clamp(0, 1)
    return large[:1], large[1:]


def test_sizes_of_the_features(images):
    features = EfficientNetLite(max(TAPS))(images[0])
    shapes = [tuple(f.shape[1:]) for f in features]
    assert shapes == [(32, 32, 32), (16, 32, 32), (24, 16, 16), (40, 8, 8), (112, 4, 4)]


def test_padding_is_tensorflows(images):
    net = EfficientNetLite(1)
    state = {k: torch.zeros_like(v) for k, v in net.state_dict().items()}
    state["stem.conv.weight"][0, 0, 2, 2] = 1  # the pixel right below the middle
    net.load_state_dict(state)
    stem = net(images[0], (0,))[0][0, 0]
    scaled = ((images[0][0, 0] - 0.498) * 1.992).clamp(0, 6)
    assert torch.allclose(stem[:-1, :-1], scaled[2::2, 2::2])
    assert not stem[-1].any() and not stem[:, -1].any()


def test_norms_are_folded():
    random = torch.Generator().manual_seed(0)
    state = {"_conv_stem.weight": torch.randn(32, 3, 3, 3, generator=random)}
    for name in ("weight", "bias", "running_mean", "running_var"):
        state[f"_bn0.{name}"] = torch.rand(32, generator=random) + 0.5
    found = converted(state, 0)
    x = torch.rand(1, 3, 9, 9, generator=random)
    plain = torch.nn.functional.batch_norm(
        torch.nn.functional.conv2d(x, state["_conv_stem.weight"]),
        *(state[f"_bn0.{n}"] for n in ("running_mean", "running_var", "weight", "bias")),
        eps=1e-3,
    )
    folded = torch.nn.functional.conv2d(x, found["stem.conv.weight"], found["stem.conv.bias"])
    assert torch.allclose(plain, folded, atol=1e-5)


def test_a_distance(images):
    torch.manual_seed(0)
    distance = ImagenetDistance(EfficientNetLite(max(TAPS)))
    a, b = images
    assert float(distance(a, a)) == 0
    wanted = a.clone().requires_grad_()
    distance(wanted, b).backward()
    assert wanted.grad.abs().sum() > 0


def test_other_files_are_refused(tmp_path):
    path = tmp_path / "other.pth"
    torch.save({"a": torch.zeros(1)}, path)
    with pytest.raises(BadInput, match="not EfficientNet-Lite0's weights"):
        load_imagenet(path)


@needs_weights
def test_it_classifies():
    data = pytest.importorskip("skimage.data")
    net = load_imagenet(blocks=16)
    for name, known in {"coffee": {967}, "chelsea": {281, 282, 285}}.items():
        image = torch.from_numpy(getattr(data, name)()).permute(2, 0, 1)[None].float() / 255
        side = min(image.shape[2:])
        top, left = ((n - side) // 2 for n in image.shape[2:])
        square = image[:, :, top : top + side, left : left + side]
        small = torch.nn.functional.interpolate(
            square, size=224, mode="bilinear", antialias=True, align_corners=False
        )
        assert int(net.classify(small).argmax()) in known


@needs_weights
@pytest.mark.parametrize("backend", ["imagenet", "imagenet+lap"])
def test_as_a_backend(backend, images):
    compare = PerceptualPyramid(backend)
    a, b = images
    assert float(compare(a, a)) < 1e-5 < float(compare(a, b))
