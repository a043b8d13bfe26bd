"""Whose motion goes onto whom."""

import math

import pytest
import torch

from mraa.affine import MIN_AXIS, affine_from_covariance, relative_affine
from mraa.avd import AvdNetwork, Transfer, hull_scale
from mraa.regions import Regions, regions_from_motion


def regions(shift, semi_axes=(0.2, 0.1), angle=0.0, mode="svd"):
    """Regions (B, K) at `shift`, ellipses of one shape and turn."""
    cos, sin = math.cos(angle), math.sin(angle)
    turn = torch.tensor([[cos, -sin], [sin, cos]])
    covariance = turn @ torch.diag(torch.tensor(semi_axes) ** 2) @ turn.T
    shift = torch.tensor(shift)
    return regions_from_motion(shift, covariance.expand(*shift.shape, 2).clone(), mode)


SOURCE = regions([[[0.0, 0.0], [0.4, 0.0], [0.0, 0.4]]])
FIRST = regions([[[0.1, 0.1], [0.3, 0.1], [0.1, 0.3]]], (0.1, 0.05))


def joined(*parts):
    stacks = ([getattr(p, name) for p in parts] for name in ("shift", "covariance", "affine"))
    return Regions(*(torch.cat(stack) for stack in stacks))


def test_standard_takes_the_driver_as_it_is():
    moved = Transfer("standard", SOURCE, "svd")(FIRST)
    torch.testing.assert_close(moved.shift, FIRST.shift)
    torch.testing.assert_close(moved.covariance, FIRST.covariance)
    torch.testing.assert_close(moved.affine, FIRST.affine)


def test_relative_begins_with_the_source_and_adds_scaled_motion():
    assert hull_scale(SOURCE.shift[0], FIRST.shift[0]) == pytest.approx(2.0)
    transfer = Transfer("relative", SOURCE, "svd")
    later = regions([[[0.15, 0.1], [0.3, 0.1], [0.1, 0.25]]], (0.2, 0.05))
    moved = transfer(joined(FIRST, FIRST))
    torch.testing.assert_close(moved.shift, SOURCE.shift.repeat(2, 1, 1))
    torch.testing.assert_close(moved.covariance, SOURCE.covariance.repeat(2, 1, 1, 1))
    moved = transfer(later)  # the first frame of the first batch stays the beginning
    torch.testing.assert_close(moved.shift, torch.tensor([[[0.1, 0.0], [0.4, 0.0], [0.0, 0.3]]]))
    # twice as long as at first, so twice the source's length of 0.2, across as it was
    wanted = torch.diag(torch.tensor([0.4, 0.1]) ** 2).expand(1, 3, 2, 2)
    torch.testing.assert_close(moved.covariance, wanted)


@pytest.mark.parametrize("mode", ["standard", "relative"])
def test_what_cannot_be_rendered_is_clamped(mode):
    flat = regions([[[0.1, 0.1], [0.3, 0.1], [0.1, 0.3]]], (0.0, 0.0))
    transfer = Transfer(mode, SOURCE, "svd")
    moved = transfer(joined(FIRST, flat))
    assert torch.isfinite(moved.affine).all()
    smallest = torch.linalg.eigvalsh(moved.covariance).amin()
    assert float(smallest) >= 0.99 * MIN_AXIS**2
    torch.testing.assert_close(moved.affine @ moved.affine.mT, moved.covariance)


def test_the_network_sees_what_was_estimated_in_batches_or_not():
    torch.manual_seed(0)
    avd = AvdNetwork(3, 8, 8).eval().requires_grad_(False)
    poses = joined(*(regions(FIRST.shift.tolist(), angle=0.1 * i) for i in range(6)))
    whole = Transfer("avd", SOURCE, "svd", avd)(poses)
    transfer = Transfer("avd", SOURCE, "svd", avd)
    parts = joined(transfer(poses[:4]), transfer(poses[4:]))
    torch.testing.assert_close(parts.shift, whole.shift)
    torch.testing.assert_close(whole.shift, avd(SOURCE.repeat(6), poses).shift)
    torch.testing.assert_close(whole.affine @ whole.affine.mT, whole.covariance)


def test_the_network_goes_with_its_mode():
    with pytest.raises(ValueError, match="mode is one of"):
        Transfer("avd", SOURCE, "svd")
    with pytest.raises(ValueError, match="mode is one of"):
        Transfer("fast", SOURCE, "svd")


@pytest.mark.parametrize("mode", ["standard", "relative"])
def test_tracked_axes_do_not_jump_where_a_region_turns(mode):
    shift = FIRST.shift.tolist()
    poses = joined(*(regions(shift, (0.2, 0.1), math.radians(2 * i)) for i in range(60)))
    largest = {}
    for tracked in (False, True):
        transfer = Transfer(mode, SOURCE, "svd", tracked=tracked)
        moved = joined(transfer(poses[:31]), transfer(poses[31:]))
        maps = relative_affine(SOURCE.affine, moved.affine, revert_axis_swap=not tracked)
        largest[tracked] = float(maps.diff(dim=0).abs().max())
    assert largest[False] > 1.5 and largest[True] < 0.1


def test_the_source_is_clamped_in_the_mode_of_the_renderer():
    thin = regions([[[0.0, 0.0]]], (0.2, 0.001), mode="lapack")
    source = Transfer("standard", thin, "lapack").source
    assert float(torch.linalg.eigvalsh(source.covariance).amin()) > 0.9 * MIN_AXIS**2
    assert torch.equal(source.affine, affine_from_covariance(source.covariance, "lapack"))
