import dataclasses

import pytest
import torch

from angie.generators.angie.channels import QUANTS, Channels
from data_prep.errors import BadInput
from mraa.motion import Motion, deltas


@pytest.fixture(scope="module")
def poses(clips) -> torch.Tensor:
    return torch.stack([clip.motion[10:35].vector() for clip in clips[:3]])  # (3, 25, 20)


@pytest.mark.parametrize("quant", QUANTS)
def test_integrating_what_is_quantised_gives_the_motion_back(statistics, poses, quant):
    channels = Channels.of(statistics, quant)
    values = channels.normalise(poses)
    assert values.shape == (3, 24, 36 if quant == "naive" else 20)
    back = channels.integrate(values, poses[:, 1])
    assert torch.allclose(back, poses[:, 1:], atol=1e-4)
    assert not channels.broken(values, poses[:, 1]).any()


def test_full_is_relative_motion_in_units_of_its_deviation(statistics, poses):
    channels = Channels.of(statistics)
    expected = deltas(poses)[:, 1:] / statistics.delta_scale
    assert torch.equal(channels.normalise(poses), expected)
    assert channels.all_relative and not channels.covariance


@pytest.mark.parametrize(
    "quant, shift, extent", [("mu_L", False, False), ("dmu_L", True, False), ("mu_dL", False, True)]
)
def test_absolute_blocks_do_not_move_with_the_start(statistics, poses, quant, shift, extent):
    channels = Channels.of(statistics, quant)
    values = channels.normalise(poses)
    moved = channels.integrate(values, poses[:, 1] + 1.0) - channels.integrate(values, poses[:, 1])
    assert torch.allclose(moved[..., :8], torch.full((), float(shift)), atol=1e-4)
    assert torch.allclose(moved[..., 8:], torch.full((), float(extent)), atol=1e-4)


def test_absolute_values_are_standardised(clips, statistics):
    channels = Channels.of(statistics, "mu_L")
    every = [channels.normalise(clip.motion.vector()) for clip in clips]
    values = torch.cat(every)
    moving = statistics.pose_deviation > 2e-4
    assert values.mean(0).abs().max() < 0.05
    assert (values.std(0)[moving] - 1).abs().max() < 0.05


def test_without_the_cholesky_factor_summed_covariances_break(statistics, poses):
    channels = Channels.of(statistics, "no_cholesky")
    values = torch.zeros(1, 9, 20)
    values[:, 4, 8] = -1e6  # c11 of the first region falls below zero at frame 5
    broken = channels.broken(values, poses[:1, 1])
    assert broken[0].tolist() == [False] * 4 + [True] * 5
    motion = Motion.from_vector(channels.integrate(values, poses[:1, 1]))
    assert (motion.cholesky[..., ::2] > 0).all()  # still something that can be shown
    assert not Channels.of(statistics).broken(values, poses[:1, 1]).any()
    values.zero_()[:, 2, 9] = 1e6  # c12 of the first region, with either sign
    for sign in (1, -1):
        broken = channels.broken(sign * values, poses[:1, 1])
        assert broken[0].tolist() == [False] * 2 + [True] * 7


def test_naive_covariances_and_roots_break_by_themselves(statistics, poses):
    channels = Channels.of(statistics, "naive")
    values, start = channels.normalise(poses[:1]), poses[:1, 1]
    assert not channels.all_relative and not channels.broken(values, start).any()
    root = channels.scale[20:] * values[0, 0, 20:] + channels.centre[20:]  # (a, b, c, d) each
    covariance = Motion.from_vector(poses[0, 1]).covariance()
    root = root.view(4, 2, 2)
    assert torch.allclose(root @ root.mT, covariance, atol=1e-5)
    flat, turned = values.clone(), values.clone()
    flat[0, 3, 8] = -1e6  # c11 of the first region, in frame 4 alone
    turned[0, 5, 20:22] *= -1
    turned[0, 5, 20:22] -= 2 * channels.centre[20:22] / channels.scale[20:22]  # first row of A
    assert channels.broken(flat, start)[0].nonzero().flatten().tolist() == [3]
    assert channels.broken(turned, start)[0].nonzero().flatten().tolist() == [5]
    old = dataclasses.replace(statistics, extent_mean=torch.zeros(0))
    with pytest.raises(BadInput, match="run the motion stage"):
        Channels.of(old, "naive")


def test_old_statistics_and_points_are_refused(statistics):
    old = dataclasses.replace(statistics, pose_mean=torch.zeros(0))
    assert Channels.of(old).all_relative
    with pytest.raises(BadInput, match="run the motion stage"):
        Channels.of(old, "mu_L")
    points = dataclasses.replace(
        statistics, rest=statistics.rest[:, :8], delta_scale=statistics.delta_scale[:8]
    )
    with pytest.raises(BadInput, match="no extent"):
        Channels.of(points, "no_cholesky")
    with pytest.raises(ValueError, match="full, no_quant"):
        Channels.of(statistics, "half")
