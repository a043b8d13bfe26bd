import numpy as np
import pytest
import torch
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from data_prep.dataset import Clip
from data_prep.errors import BadInput
from mraa.perceptual import PerceptualDistance, PerceptualPyramid, l1, psnr, score, ssim
from mraa.reconstruction import reconstruct, spread
from mraa.renderer import GeneratorConfig, HourglassConfig, Renderer, RendererConfig


def waves():
    """Two pictures (1, 3, 40, 48) that follow from a formula."""
    y, x = np.mgrid[0:40, 0:48]
    channel = np.arange(3)[:, None, None]
    a = 0.5 + 0.4 * np.sin(x / 5 + channel) * np.cos(y / 7)
    b = 0.9 * a + 0.05 + 0.1 * np.sin(1.3 * x * (1 + channel)) * np.sin(0.9 * y)
    return (torch.from_numpy(v).float()[None] for v in (a, b.clip(0, 1)))


def test_values_worked_by_hand():
    black, grey = torch.zeros(2, 3, 16, 16), torch.full((2, 3, 16, 16), 0.1)
    assert l1(grey, black).tolist() == pytest.approx([0.1, 0.1])
    assert psnr(grey, black).tolist() == pytest.approx([20.0, 20.0], abs=1e-4)
    assert psnr(grey, grey).tolist() == pytest.approx([100.0, 100.0])
    # flat pictures have no variance: what remains is (2ab + C1) / (a^2 + b^2 + C1)
    a, b = torch.full((1, 1, 11, 11), 0.2), torch.full((1, 1, 11, 11), 0.6)
    assert ssim(a, b).item() == pytest.approx((0.24 + 1e-4) / (0.4 + 1e-4), abs=1e-4)


def test_ssim_and_psnr_are_those_of_scikit_image():
    a, b = waves()
    ours, theirs = (x[0].numpy().astype(np.float64) for x in (a, b))
    wanted = structural_similarity(
        ours,
        theirs,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        data_range=1,
        channel_axis=0,
    )
    assert ssim(a, b).item() == pytest.approx(wanted, abs=2e-5) and 0.5 < wanted < 0.9
    wanted = peak_signal_noise_ratio(ours, theirs, data_range=1)
    assert psnr(a, b).item() == pytest.approx(wanted, abs=1e-4) and 20 < wanted < 30
    assert ssim(a, a).item() == pytest.approx(1, abs=1e-6)


def test_ssim_wants_a_whole_window():
    with pytest.raises(ValueError, match="11x11"):
        ssim(torch.zeros(1, 3, 10, 64), torch.zeros(1, 3, 10, 64))


def test_scores_are_of_each_image_by_itself():
    perceptual = PerceptualDistance()
    assert perceptual.backend == "random_vgg"
    torch.manual_seed(0)
    images, truth = torch.rand(2, 3, 64, 64), torch.rand(2, 3, 64, 64)
    both = score(images, truth, perceptual)
    second = score(images[1:], truth[1:], perceptual)
    for name in ("l1", "psnr", "ssim", "perceptual"):
        assert getattr(both, name)[1].item() == pytest.approx(getattr(second, name).item())
    assert score(truth, truth, perceptual).perceptual.tolist() == [0, 0]


def test_the_perceptual_distance_is_the_deep_part_of_the_loss():
    torch.manual_seed(0)
    image, truth = torch.rand(1, 3, 64, 64), torch.rand(1, 3, 64, 64)
    loss = PerceptualPyramid("random_vgg", width=32)
    assert PerceptualDistance()(image, truth).item() == pytest.approx(float(loss(image, truth)))
    with pytest.raises(BadInput, match="no such file"):
        PerceptualDistance("none.pth")


def test_reconstruction_of_the_copy_is_measured_against_the_first_frame(dataset):
    torch.manual_seed(0)
    config = RendererConfig(
        regions=2,
        estimator=HourglassConfig(4, 3, 16),
        background=HourglassConfig(4, 3, 16),
        background_scale=0.25,
        flow=HourglassConfig(4, 3, 16),
        generator=GeneratorConfig("lite", width=16, bottleneck_blocks=1),
    )
    clip = dataset.clips("test")[0]
    stride = clip.n_frames - 1
    result = reconstruct(Renderer(config), dataset, [clip], stride=stride)
    store = dataset.frames(clip)
    first, last = (store[i].astype(np.float64) / 255 for i in (0, -1))
    assert result.frames == 1 and result.backend == "random_vgg"
    assert result.copy_l1 == pytest.approx(np.abs(first - last).mean(), abs=1e-5)
    error = ((first - last) ** 2).mean()
    assert result.copy_psnr == pytest.approx(-10 * np.log10(error), abs=1e-3)
    assert result.psnr < result.copy_psnr and result.ssim < 1 and result.perceptual > 0
    assert result.as_dict()["backend"] == "random_vgg"
    with pytest.raises(ValueError, match="no clip is longer"):
        reconstruct(Renderer(config), dataset, [clip], stride=stride + 1)


def test_of_many_clips_some_are_spread_over_all():
    clips = [Clip(str(i), "a", "test", "a", 0.0, 100) for i in range(50)]
    assert spread(clips, 5000) == clips and spread(clips[:1], 50) == clips[:1]
    assert [clip.id for clip in spread(clips, 1000)] == [str(i) for i in range(0, 50, 5)]
    assert [clip.id for clip in spread(clips, 1999)] == [str(i) for i in range(0, 50, 3)]
    assert spread(clips, 99) == clips[:1] and spread([], 99) == []
    uneven = [Clip(str(i), "a", "test", "a", 0.0, 100 + 60 * (i % 2)) for i in range(9)]
    assert [clip.n_frames for clip in spread(uneven, 600)] == [100] * 5
