import math

import pytest
import torch

from angie.motion.drift import (
    Anchors,
    activity,
    bounded,
    integrate_bounded,
    integrate_leaky,
    pauses,
    reanchor,
    remove_mean,
    soft_range,
)
from mraa.motion import integrate


def test_auto_bounds_only_above_ten_seconds():
    assert not bounded("auto", 250) and bounded("auto", 251)
    assert bounded("on", 1) and not bounded("off", 10_000)
    with pytest.raises(ValueError, match="auto, on, off"):
        bounded("maybe", 1)


def test_leaky_integration_of_a_hand_worked_case():
    # tau = 1/25 s: rho = e^-1; y1 = 2 - 1 = 1, y2 = y1/e + 3, y3 = y2/e + 0
    motion = integrate_leaky(
        torch.tensor([[7.0], [3.0], [0.0]]), torch.tensor([2.0]), torch.tensor([1.0]), tau=1 / 25
    )
    second = 1 / math.e + 3
    expected = torch.tensor([[2.0], [1 + second], [1 + second / math.e]])
    assert torch.allclose(motion, expected)


def test_without_a_leak_it_is_the_plain_sum():
    delta, start = torch.randn(50, 4) * 0.01, torch.randn(4)
    assert torch.allclose(
        integrate_leaky(delta, start, start, tau=1e9), integrate(delta, start), atol=1e-5
    )


def test_soft_range_leaves_the_middle_alone_and_bends_the_rest():
    values = torch.tensor([[0.0], [0.79], [-0.8], [0.9], [50.0], [-50.0]])
    bent = soft_range(values, torch.tensor([-1.0]), torch.tensor([1.0]))
    assert torch.equal(bent[:3], values[:3])
    assert bent[3].item() == pytest.approx(0.8 + 0.2 * math.tanh(0.5))
    assert bent[4].item() == pytest.approx(1.0) and bent[5].item() == pytest.approx(-1.0)


def test_soft_range_keeps_a_start_outside_it():
    values = torch.tensor([[2.0], [3.0]])
    bent = soft_range(values, torch.tensor([-1.0]), torch.tensor([1.0]))
    assert bent[0].item() == 2.0
    assert 2.0 < bent[1].item() <= 2.5


def test_a_minute_of_biased_deltas_stays_bounded():
    # a bias of 1e-4 a frame: the plain sum ends 0.15 away, the leak settles at
    # 1e-4 / (1 - exp(-1/200)) = 0.02005
    frames, bias = 1500, 1e-4
    delta = torch.full((frames, 5), bias)
    start = torch.zeros(5)
    wide = torch.ones(5)
    plain = integrate(delta, start)
    leaky = integrate_bounded(delta, start, start, -wide, wide)
    assert plain.abs().max() > 0.14
    assert leaky[-1, 0].item() == pytest.approx(bias / (1 - math.exp(-1 / 200)), rel=1e-3)
    assert leaky.abs().max() < 0.05


def test_frame_one_is_the_start_exactly():
    start, rest = torch.randn(5), torch.randn(5)
    low, high = torch.full((5,), -0.01), torch.full((5,), 0.01)
    motion = integrate_bounded(torch.randn(300, 5), start, rest, low, high)
    assert torch.equal(motion[0], start)


def test_the_constant_part_goes_with_the_activity():
    # activities: sqrt((9 + 16) / 2), 0, sqrt((1 + 1) / 2)
    delta = torch.tensor([[3.0, 4.0], [0.0, 0.0], [-1.0, 1.0]])
    active = activity(delta)
    assert torch.allclose(active, torch.tensor([[12.5**0.5], [0.0], [1.0]]))
    mean = delta.sum(0) / active.sum()
    removed = remove_mean(delta, mean)
    assert torch.allclose(removed.sum(0), torch.zeros(2), atol=1e-6)
    assert (removed[1] == 0).all()  # a still frame stays still


def test_pauses_are_long_enough_and_eight_seconds_apart():
    calm = torch.zeros(700, dtype=torch.bool)
    calm[100:120] = True  # too early
    calm[300:309] = True  # too short
    calm[320:330] = True
    calm[400:420] = True  # too near
    calm[520:] = True
    assert pauses(calm) == [329, 529]


def test_reanchoring_goes_half_way_to_the_nearest_pose_and_is_forgotten():
    displacement = torch.full((700, 2), 1.0)
    anchors = torch.tensor([[0.0, 0.0], [3.0, 1.0]])  # the first is nearer in units of the scale
    moved = reanchor(displacement, [300], anchors, torch.tensor([1.0, 10.0]), tau=1e9)
    assert torch.equal(moved[:301], displacement[:301])
    assert torch.allclose(moved[325:], torch.full((375, 2), 0.5), atol=1e-4)
    assert (moved[301:325].diff(dim=0) < 0).all()  # without a jump
    leaky = reanchor(displacement, [300], anchors, torch.tensor([1.0, 10.0]), tau=2.0)
    assert torch.allclose(leaky[400], torch.full((2,), 1 - 0.5 * math.exp(-100 / 50)), atol=1e-4)
    again = reanchor(displacement, [300, 500], anchors, torch.tensor([1.0, 10.0]), tau=1e9)
    assert torch.allclose(again[600], torch.full((2,), 0.25), atol=1e-4)


def test_bounded_motion_can_be_reanchored_in_its_pauses():
    delta = torch.zeros(400, 2)
    delta[1] = 1.0
    calm = torch.ones(400, dtype=torch.bool)
    low, high, zero = torch.full((2,), -9.0), torch.full((2,), 9.0), torch.zeros(2)
    anchors = Anchors(torch.zeros(1, 2), torch.ones(2), calm)
    plain = integrate_bounded(delta, zero, zero, low, high)
    anchored = integrate_bounded(delta, zero, zero, low, high, anchors)
    assert torch.equal(plain[:200], anchored[:200])
    assert torch.allclose(anchored[300:], plain[300:] / 2, atol=1e-4)
