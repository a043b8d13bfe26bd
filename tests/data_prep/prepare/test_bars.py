"""Black bars: found when dark, even and straight; a dark stage is none."""

import numpy as np
import pytest

from data_prep.prepare.analysis import BarDetector, View, inner_part


def picture(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(30, 220, (270, 480)).astype(np.uint8)


def barred(top: int, left: int, level: int = 16) -> np.ndarray:
    shown = picture()
    rng = np.random.default_rng(1)
    bar = rng.integers(level - 3, level + 4, shown.shape).astype(np.uint8)
    inside = np.zeros(shown.shape, bool)
    inside[top : 270 - top, left : 480 - left] = True
    return np.where(inside, shown, bar)


def test_letterbox_and_pillars_are_left_out_with_a_pixel_more() -> None:
    left, top, right, bottom = inner_part(barred(30, 0)) or ()
    assert (left, right) == (0, 1)
    assert (top * 270, bottom * 270) == pytest.approx((31, 239))
    left, top, right, bottom = inner_part(barred(20, 40, level=4)) or ()
    edges = (left * 480, top * 270, right * 480, bottom * 270)
    assert edges == pytest.approx((41, 21, 439, 249))


def test_a_picture_without_bars_stays_whole() -> None:
    assert inner_part(picture()) == (0, 0, 1, 1)
    assert inner_part(np.zeros((270, 480), np.uint8)) is None


def test_a_lit_speaker_on_a_dark_stage_has_no_bars() -> None:
    stage = np.full((270, 480), 3, np.uint8)
    stage[60:, 200:280] = picture()[60:, 200:280]  # a body
    stage[30:60, 225:255] = 180  # a head
    assert inner_part(stage) == (0, 0, 1, 1)


def test_view_is_in_pixels_of_the_original_and_by_shot() -> None:
    detector = BarDetector()
    for k in range(20):
        detector.add(barred(30, 0) if k < 10 else picture(), cut=k in (0, 10))
    assert detector.view(0, 10, 1920, 1080) == View(0, 124, 1920, 956)
    assert detector.view(10, 20, 1920, 1080) == View(0, 0, 1920, 1080)
    assert detector.view(0, 20, 1920, 1080) == View(0, 0, 1920, 1080)
    assert View(0, 124, 1920, 956).of(np.zeros((1080, 1920, 3))).shape == (832, 1920, 3)
