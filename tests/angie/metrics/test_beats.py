"""Beat scores by hand: beats on the onsets, beside them, silence, one beat, no motion."""

import numpy as np
import pytest

from angie.metrics import beats

FPS = 25
ONE = np.ones(1)


def swinging(times, seconds=6.0, fps=FPS) -> np.ndarray:
    """One point (T, 1, 2) whose speed falls to a minimum in the frames at `times` seconds."""
    at = np.arange(round(seconds * fps)) / fps
    away = np.abs(at[:, None] - np.asarray(times)).min(1)
    speed = 0.02 + np.minimum(away, 0.3) + away / 100  # units a frame; the lowest at each time
    path = np.cumsum(speed)
    return np.stack([path, np.zeros_like(path)], axis=1)[:, None]


TIMES = np.array([1.0, 2.0, 3.0, 4.0, 5.0])


def test_consistency_is_one_where_beats_are_the_onsets():
    score = beats.consistency([swinging(TIMES)], [TIMES], ONE, FPS)
    assert score.value == 1
    assert score.counts == {
        "clips": 1, "without motion beats": 0, "without onsets": 0, "onsets": 5
    }  # fmt: skip


@pytest.mark.parametrize("fps", [15, 25, 60])
def test_consistency_at_two_sigma_at_any_frame_rate(fps):
    late = TIMES + round(0.2 * fps) / fps  # two sigma: exp(-2)
    clip = swinging(TIMES, fps=fps)
    usual = beats.usual_steps([clip])
    assert beats.consistency([clip], [late], usual, fps).value == pytest.approx(np.exp(-2))


def test_consistency_weighs_clips_by_their_onsets():
    right, wrong = swinging(TIMES), swinging(TIMES + 0.48)
    score = beats.consistency([right, wrong], [TIMES, TIMES[:1]], ONE, FPS)
    assert score.value == pytest.approx((5 + np.exp(-(0.48**2) / 0.02)) / 6)


def test_small_dips_are_no_beats():
    # activity of mean 1 with dips of 0.02, less than the prominence
    step = np.where(np.arange(100) % 10 == 5, 0.98, 1.0)
    clip = np.stack([np.cumsum(step), 0 * step], axis=1)[:, None]
    assert beats.consistency([clip], [TIMES], ONE, FPS).value is None
    assert beats.consistency([clip], [TIMES], ONE / 2, FPS).value is not None  # dips of 0.04


def test_silence_and_stillness_are_told_and_left_out():
    still, silence = np.zeros((150, 1, 2)), np.zeros(0)
    for compute in (
        lambda points, onsets: beats.consistency(points, onsets, ONE, FPS),
        lambda points, onsets: beats.matched(points, onsets, FPS),
        lambda points, onsets: beats.align(points, onsets, FPS),
        lambda points, onsets: beats.align(points, onsets, FPS, "bailando"),
    ):
        score = compute([still, swinging(TIMES)], [TIMES, silence])
        assert score.value is None
        assert "1 without motion beats" in score.reason and "1 without onsets" in score.reason
        assert compute([], []).reason == "no clips"
        both = compute([still, swinging(TIMES), swinging(TIMES)], [TIMES, silence, TIMES])
        assert both.value == compute([swinging(TIMES)], [TIMES]).value
        assert both.counts["clips"] == 1


def test_matched_beats_at_the_extremes_and_with_a_single_beat():
    clip = swinging(TIMES)
    assert beats.matched([clip], [TIMES], FPS).value == 100
    assert beats.matched([clip], [TIMES + 0.4], FPS).value == 0
    assert beats.matched([clip], [TIMES[:1]], FPS).value == 20
    assert beats.matched([swinging([2.0])], [TIMES], FPS).value == 100


def test_onsets_too_near_one_another_match_once():
    # two motion beats 0.28 s apart around one onset and its echo 0.1 s later, which does not count
    clip = swinging([2.0, 2.28])
    score = beats.matched([clip], [np.array([2.1, 2.2])], FPS)
    assert score.value == 50 and score.counts["matched"] == 1


def test_the_curve_rises_with_the_threshold():
    curve = beats.matched_curve([swinging(TIMES)], [TIMES + 0.22], FPS)
    assert list(curve) == [0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5]
    assert [curve[near].value for near in (0.2, 0.25)] == [0, 100]


def test_the_step_that_the_first_frame_lacks_takes_no_beat_from_those_after_it():
    frame = np.arange(150)
    path = np.cumsum(2 - np.cos(np.pi * (frame - 3) / 6))  # slowest in frames 3, 15, 27 ...
    clip = np.stack([path, 0 * path], axis=1)[:, None]
    score = beats.matched([clip], [np.arange(3, 148, 12) / FPS], FPS, near=0.03)
    assert score.value == 100 and score.counts["beats"] == 13


@pytest.mark.parametrize("mode", ["aist", "bailando"])
def test_alignment_is_one_on_the_beat_and_less_beside_it(mode):
    clip = swinging(TIMES)
    assert beats.align([clip], [TIMES], FPS, mode).value == pytest.approx(1)
    beside = beats.align([clip], [TIMES + 0.04], FPS, mode).value
    assert beside == pytest.approx(np.exp(-(0.04**2) / (2 * 0.05**2)))


def test_alignment_counts_what_each_source_counts():
    # one onset, five motion beats a second apart: AIST asks every motion beat, Bailando the onset
    clip = swinging(TIMES)
    assert beats.align([clip], [TIMES[:1]], FPS, "aist").value == pytest.approx(0.2)
    assert beats.align([clip], [TIMES[:1]], FPS, "bailando").value == pytest.approx(1)
    with pytest.raises(ValueError, match="aist or bailando"):
        beats.align([clip], [TIMES], FPS, "music")


def test_usual_steps_are_means_over_frames():
    points = np.zeros((5, 2, 2))
    points[:, 1, 0] = np.arange(5) * 3
    np.testing.assert_allclose(beats.usual_steps([points, points]), [0, 3])


@pytest.mark.parametrize("hole", [np.nan, np.inf])
@pytest.mark.parametrize("score", ["consistency", "matched", "align"])
def test_motion_that_is_not_finite_is_told(score, hole):
    broken = swinging(TIMES)
    broken[10] = hole
    usual = (ONE,) if score == "consistency" else ()
    found = getattr(beats, score)([swinging(TIMES), broken], [TIMES, TIMES], *usual, FPS)
    assert (found.value, found.reason) == (None, "motion is not finite")
    assert found.counts == {"not finite": 1}


def test_one_frame_is_without_beats():
    score = beats.matched([swinging(TIMES)[:1]], [TIMES], FPS)
    assert score.value is None and score.counts["without motion beats"] == 1
