"""Regions that spread further than in training move less, and all of a photo that is unlike it."""

from types import SimpleNamespace

import pytest
import torch

from angie.motion.amplitude import is_stranger, spread, trust
from mraa.motion import Motion


def test_spread_is_the_larger_diagonal_over_the_largest_of_training():
    pose = Motion(torch.zeros(1, 2, 2), torch.tensor([[[0.2, 0.9, 0.1], [0.1, 0.0, 0.6]]]))
    statistics = SimpleNamespace(diagonal_high=torch.tensor([[0.4, 0.4], [0.2, 0.2]]))
    assert spread(pose, statistics).tolist() == pytest.approx([0.5, 3.0])


def test_trust_falls_with_the_spread_of_a_region_and_of_the_photo():
    usual = torch.tensor([0.5, 0.9, 1.2, 0.6])
    assert trust(usual).tolist() == [1, 1, 1, 1] and not is_stranger(usual)
    one = torch.tensor([0.2, 0.2, 2.6, 0.2])  # mean 0.8
    assert trust(one).tolist() == pytest.approx([1, 1, 0.5, 1]) and not is_stranger(one)
    strange = torch.tensor([1.0, 1.0, 0.5, 6.0])  # mean 2.125
    assert trust(strange).tolist() == pytest.approx([0.6, 0.6, 0.6, 0.24])
    assert is_stranger(strange)
