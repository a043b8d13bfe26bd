"""Equivariance and its weights by hand, and what the renderer's optimiser is set to."""

import dataclasses

import pytest
import torch

from mraa.affine import affine_from_covariance
from mraa.losses import ThinPlate, equivariance, thin_plate
from mraa.perceptual import PerceptualPyramid
from mraa.regions import RegionEstimator, Regions
from mraa.training.objective import Objective, RendererTraining
from mraa.training.renderer import adam, perceptual_loss


def regions(shift, covariance) -> Regions:
    covariance = torch.tensor(covariance)
    return Regions(torch.tensor(shift), covariance, affine_from_covariance(covariance))


def test_the_random_transform_has_the_published_spread():
    transform = thin_plate(torch.ones(1, 31))
    assert torch.allclose(transform.theta[0], torch.eye(2, 3) + 0.05)
    assert torch.allclose(transform.coefficients, torch.full((1, 1, 25), 0.005))


def test_equivariance_of_a_hand_worked_stretch():
    # the plane twice as wide; a round region seen through it half as wide
    wider = ThinPlate(torch.tensor([[[2.0, 0, 0.1], [0, 1.0, 0]]]), torch.zeros(1, 1, 25))
    there = regions([[[0.2, 0.3]]], [[[[0.04, 0.0], [0.0, 0.16]]]])
    here = regions([[[0.5, 0.3]]], [[[[0.16, 0.0], [0.0, 0.16]]]])
    losses = equivariance(here, there, wider)
    assert float(losses.shift) == pytest.approx(0.0, abs=1e-6)
    off = regions([[[0.7, 0.3]]], [[[[0.16, 0.0], [0.0, 0.16]]]])
    assert float(equivariance(off, there, wider).shift) == pytest.approx(0.1)  # 0.2 of 2 numbers


def test_equivariance_of_the_affine_is_zero_where_it_follows_and_whatever_its_sign():
    same = ThinPlate(torch.eye(2, 3)[None], torch.zeros(1, 1, 25))
    here = regions([[[0.0, 0.0]]], [[[[0.09, 0.02], [0.02, 0.04]]]])
    assert float(equivariance(here, here, same).affine) == pytest.approx(0.0, abs=1e-5)
    turned = dataclasses.replace(here, affine=-here.affine)
    assert float(equivariance(here, turned, same).affine) == pytest.approx(0.0, abs=1e-5)
    twice = dataclasses.replace(here, affine=2 * here.affine)  # |I - 2 I| over four numbers
    assert float(equivariance(here, twice, same).affine) == pytest.approx(0.5, abs=1e-5)
    half = ThinPlate(torch.tensor([[[0.5, 0, 0], [0, 0.5, 0]]]), torch.zeros(1, 1, 25))
    assert float(equivariance(here, here, half).affine) == pytest.approx(0.25, abs=1e-5)


class Stub(torch.nn.Module):
    """An estimator of four regions without a renderer around it."""

    def __init__(self) -> None:
        super().__init__()
        self.estimator = RegionEstimator(4, 4, 2, 8)
        self.config = type("Config", (), {"align_corners": True})()


def test_the_equivariance_losses_are_weighed():
    torch.manual_seed(0)
    stub, frame, noise = Stub(), torch.rand(1, 3, 64, 64), torch.randn(1, 31)
    stub.estimator.eval()
    seen = stub.estimator(frame)
    values = {}
    for weights in ((1.0, 1.0), (10.0, 0.5)):
        training = RendererTraining(equivariance_shift=weights[0], equivariance_affine=weights[1])
        objective = Objective(stub, training, compare=None)
        values[weights] = objective._regions(frame, seen, noise)
    one, other = values.values()
    assert float(one["shift"]) > 0 and float(one["affine"]) > 0
    assert float(other["shift"]) == pytest.approx(10 * float(one["shift"]))
    assert float(other["affine"]) == pytest.approx(0.5 * float(one["affine"]))


def test_the_perceptual_loss_is_weighed():
    torch.manual_seed(0)
    prediction, truth = torch.rand(2, 1, 3, 64, 64)
    training = RendererTraining(perceptual_width=4)
    compare, twice = (
        perceptual_loss(dataclasses.replace(training, perceptual=w)) for w in (10.0, 20.0)
    )
    assert isinstance(compare, PerceptualPyramid)
    value = float(compare(prediction, truth))
    assert float(twice(prediction, truth)) == pytest.approx(2 * value, rel=1e-5)


def test_a_region_is_where_its_heatmap_is_and_never_without_extent():
    estimator = RegionEstimator(2, 4, 2, 8, covariance_floor=1e-4).eval()
    torch.nn.init.zeros_(estimator.regions.weight)
    torch.nn.init.zeros_(estimator.regions.bias)
    even = estimator(torch.rand(1, 3, 64, 64))
    assert even.heatmap.shape[-1] == 10  # a quarter of the image, less the 7x7 without padding
    place = torch.linspace(-1, 1, 10)
    spread = float(place.square().mean()) + 1e-4
    assert torch.allclose(even.shift, torch.zeros(1, 2, 2), atol=1e-6)
    assert torch.allclose(even.covariance[0, 0], spread * torch.eye(2), atol=1e-6)
    # logits are divided by the temperature: 0.1 makes ten times as steep a heatmap
    torch.nn.init.normal_(estimator.regions.weight, std=0.05)
    image = torch.rand(1, 3, 64, 64)
    flat, estimator.temperature = estimator(image).heatmap.log(), 0.2
    half = estimator(image).heatmap.log()
    flat, half = (h - h.mean((2, 3), keepdim=True) for h in (flat, half))
    assert torch.allclose(flat, 2 * half, atol=1e-4)


def test_the_renderer_s_optimiser():
    group = adam(torch.nn.Linear(1, 1), RendererTraining()).param_groups[0]
    assert group["lr"] == 2e-4 and tuple(group["betas"]) == (0.5, 0.999)
