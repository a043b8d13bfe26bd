import math

import numpy as np
import pytest
import torch

from angie.generators.angie.gpt import CoSpeechGPT, GPTConfig
from angie.generators.angie.report import audio_sensitivity, far_windows, order2_entropy
from angie.motion.windows import MotionWindows


def test_an_order_2_model_knows_a_cycle_and_no_more():
    cycle = np.array([[0, 1, 2, 3] * 3] * 50)
    assert order2_entropy(cycle, cycle[:1], 4) < 0.05
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 4, (400, 12))
    assert order2_entropy(noise, noise[:50], 4) == pytest.approx(math.log(4), abs=0.15)
    with np.errstate(divide="raise"):  # codes never seen have a probability too
        assert np.isfinite(order2_entropy(np.zeros((2, 12), int), np.ones((2, 12), int), 4))


def test_an_order_2_model_of_a_hand_worked_case(monkeypatch):
    monkeypatch.setattr("angie.generators.angie.report.WEIGHTS", (1.0,))
    # one window 0 1: order 0 counts {0: 1, 1: 1}, order 1 counts after 0 {1: 1}
    # p0(1) = (1 + 1/2) / (2 + 1) = 1/2, p1(1 | 0) = (1 + 1/2) / (1 + 1) = 3/4
    entropy = order2_entropy(np.array([[0, 1]]), np.array([[0, 1]]), 2)
    assert entropy == pytest.approx(-math.log(3 / 4))


def coded(windows: MotionWindows, seed: int) -> MotionWindows:
    source = torch.Generator().manual_seed(seed)
    codes = torch.randint(8, (len(windows), 2, 12), generator=source)
    return windows.choose(["onset", "speaker"], codes=codes)


def test_a_gpt_that_knows_nothing_hears_nothing(clips, statistics):
    windows, held_out = MotionWindows(clips[:8], statistics), MotionWindows(clips[8:], statistics)
    gpt = CoSpeechGPT(GPTConfig(codes=8, width=16, heads=2, layers=1)).eval()
    result = audio_sensitivity(gpt, coded(windows, 0), coded(held_out, 1))
    assert result is not None
    for values in (result.right, result.mismatched, result.order2):
        assert len(values) == 2
        assert values == pytest.approx([math.log(8)] * 2, abs=0.2)
    assert set(result.as_dict()) == {"right", "mismatched", "order2"}


def test_without_another_clip_there_is_no_result(clips, statistics):
    windows = coded(MotionWindows(clips[:1], statistics), 0)
    gpt = CoSpeechGPT(GPTConfig(codes=8, width=16, heads=2, layers=1)).eval()
    assert audio_sensitivity(gpt, windows, windows) is None


def test_mismatched_sound_is_of_the_same_speaker(clips, statistics):
    windows = MotionWindows(clips, statistics)
    speaker = [windows.clips[index].speaker for index, _ in windows.places]
    assert len(set(speaker)) > 1  # or the test says nothing
    far = far_windows(windows)
    assert [speaker[place] for place in far] == speaker
    assert sorted(far) == list(range(len(windows)))
    assert all(i != place for i, place in enumerate(far))
