import pytest
import torch
import torchvision
from torchvision.models.feature_extraction import create_feature_extractor

from data_prep.errors import BadInput
from mraa.perceptual import (
    ImagePyramid,
    PerceptualPyramid,
    bands_distance,
    laplacian_distance,
    load_vgg19,
    random_vgg,
    ssim,
)
from mraa.training.objective import RendererTraining


def test_random_vgg_follows_from_its_seed_and_is_calibrated():
    torch.manual_seed(1)
    a = random_vgg(8)
    torch.manual_seed(2)
    b = random_vgg(8)
    image = torch.rand(1, 3, 64, 64)
    taps = a(image)
    assert len(taps) == 5 and [t.shape[1] for t in taps] == [8, 16, 32, 64, 64]
    assert all(torch.equal(x, y) for x, y in zip(taps, b(image), strict=True))


@pytest.mark.parametrize("backend", ["random_vgg", "lap", "random_vgg+lap"])
def test_perceptual_distance_grows_with_the_difference(backend):
    torch.manual_seed(0)
    loss = PerceptualPyramid(backend, width=8)
    assert loss.backend == backend
    image = torch.rand(1, 3, 64, 64)
    near, far = (loss(image, (image + s * torch.randn_like(image))) for s in (0.02, 0.2))
    assert abs(float(loss(image, image))) < 1e-5 < float(near) < float(far)


def test_vgg19_from_a_local_file(tmp_path):
    """The taps are torchvision's own layers relu1_1 to relu5_1; small pictures give fewer."""
    torch.manual_seed(0)
    features = torchvision.models.vgg19().features
    path = tmp_path / "vgg19.pth"
    torch.save({f"features.{k}": v for k, v in features.state_dict().items()}, path)
    vgg = load_vgg19(path)
    assert sum(p.requires_grad for p in vgg.parameters()) == 0
    image = torch.rand(1, 3, 32, 32)
    names = {f"{i}": f"{i}" for i in (1, 6, 11, 20, 29)}
    extract = create_feature_extractor(features.eval(), names)
    wanted = extract((image - vgg.mean) / vgg.std)
    for tap, ours in zip(wanted.values(), vgg(image), strict=True):
        torch.testing.assert_close(tap, ours)
    assert len(vgg(image[..., :8, :8])) == 4
    with pytest.raises(BadInput, match="no such file"):
        load_vgg19(tmp_path / "none.pth")
    (tmp_path / "bad.pth").write_bytes(b"nothing")
    with pytest.raises(BadInput, match="not a readable checkpoint"):
        load_vgg19(tmp_path / "bad.pth")
    torch.save({"features.0.weight": torch.zeros(64, 3, 3, 3)}, path)
    with pytest.raises(BadInput, match="not a VGG19 state dict"):
        load_vgg19(path)


def test_the_parts_of_the_offline_backend_add_up():
    torch.manual_seed(0)
    image, truth = torch.rand(2, 1, 3, 64, 64)
    deep, bands, both = (
        float(PerceptualPyramid(name, width=8, weight=3.0)(image, truth))
        for name in ("random_vgg", "lap", "auto")
    )
    assert both == pytest.approx(deep + bands)
    pyramid = ImagePyramid()
    distance = laplacian_distance(pyramid(image), pyramid(truth))
    assert bands == pytest.approx(3 * float(4 * distance + 1 - ssim(image, truth)[0]))


def test_bands_of_a_flat_difference_are_all_in_the_coarsest():
    """A constant 0.5 has no detail: every band but the last is zero but for the borders."""
    flat = [torch.full((1, 3, s, s), 0.5) for s in (32, 16, 8, 4)]
    assert float(laplacian_distance(flat, [0 * x for x in flat])) == pytest.approx(0.5)


def test_small_pictures_are_compared_by_bands_alone():
    """11 pixels are SSIM's window: 10 do without, and a flat difference is in the last band."""
    flat = [torch.full((1, 3, s, s), 0.5) for s in (10, 5)]
    assert float(bands_distance(flat, [0 * x for x in flat])) == pytest.approx(4 * 0.5)
    flat = [torch.full((1, 3, s, s), 0.5) for s in (16, 8)]
    assert float(bands_distance(flat, [0 * x for x in flat])) > 4 * 0.5 + 0.9


def test_which_backend_settings_mean():
    assert RendererTraining().backend == "random_vgg+lap"
    assert RendererTraining(perceptual_weights="vgg.pth").backend == "vgg19"
    assert RendererTraining(perceptual_backend="lap", perceptual_weights="x").backend == "lap"
    with pytest.raises(ValueError, match="needs its file"):
        RendererTraining(perceptual_backend="vgg19")
    with pytest.raises(ValueError, match="is auto, vgg19, random_vgg"):
        RendererTraining(perceptual_backend="lpips")
