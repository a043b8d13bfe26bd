"""The phantom keeps time: hand-worked scores, and its motion against its own and other sound."""

import numpy as np
import pytest
import soxr

from data_prep.phantom.make import Take, take
from data_prep.phantom.skeleton import JOINTS
from data_prep.rates import FPS, SAMPLE_RATE
from data_prep.speech import synchrony
from data_prep.speech.spectra import onset_times


def test_beat_consistency_by_hand() -> None:
    motion = np.array([1.0, 2.0])
    assert synchrony.beat_consistency(motion, np.array([1.0, 2.0])) == 1
    # one onset at no distance, one at sigma: (1 + exp(-1/2)) / 2
    assert synchrony.beat_consistency(motion, np.array([1.0, 2.1])) == pytest.approx(0.80326533)


def test_matched_beats_use_every_onset_once_and_in_order() -> None:
    sound = np.array([1.0, 2.0])
    assert synchrony.matches(np.array([0.9, 1.1, 2.1]), sound) == 2
    assert synchrony.matches(np.array([1.25, 2.0]), sound) == 1
    np.testing.assert_allclose(synchrony.spaced(np.array([0, 0.1, 0.2, 0.5])), [0, 0.2, 0.5])


def test_minima_lie_below_both_neighbours_and_well_below_one() -> None:
    curve = np.array([0, 0, 1, 0.5, 0.51, 0.5, 0.49, 0.5, 1, 0, 1])
    # at 3 it is 0.5 below frame 2; at 6 only 0.01 below both; the last two frames have none
    assert (synchrony.minima(curve, FPS) * FPS).tolist() == [3, 9]
    assert (synchrony.minima(curve, FPS, 0.005) * FPS).tolist() == [3, 6, 9]


def test_changes_are_those_of_hands_and_arms(scoring) -> None:
    joints = np.zeros((2, len(JOINTS), 2))
    at = {name: index for index, name in enumerate(JOINTS)}
    for side, x in (("right", -1.0), ("left", 1.0)):
        joints[:, at[f"{side}_shoulder"]] = x, 0
        joints[:, at[f"{side}_elbow"]] = x, 1
        joints[:, at[f"{side}_wrist"]] = x, 2
    joints[1, at["left_wrist"]] = 2, 1  # the forearm turns from down to out
    assert scoring.steps(joints)[1].tolist() == [
        pytest.approx(2**0.5 if name == "left_wrist" else 0) for name in scoring.ACTIVE
    ]
    turned = [[0] * 4, [0, 0, 0, np.pi / 2]]
    np.testing.assert_allclose(scoring.arm_turns(joints), turned, atol=1e-9)


def sound(shot: Take) -> np.ndarray:
    samples = soxr.resample(shot.speech.samples, shot.speech.rate, SAMPLE_RATE)
    return onset_times(samples).astype(np.float64)


def test_motion_keeps_time_with_its_own_sound_and_not_with_another(scoring) -> None:
    shots = [take(index, 2, seconds=14, seed=7) for index in range(4)]
    onsets = [sound(shot) for shot in shots]
    end = min(shot.speech.duration for shot in shots)
    scores: dict[bool, list[tuple[float, float]]] = {True: [], False: []}
    for i, shot in enumerate(shots):
        steps = scoring.steps(shot.joints.points)
        beats = synchrony.minima(synchrony.activity(steps, steps.mean(0)), FPS)
        ends = synchrony.smooth_minima(steps.mean(1), FPS)
        for j, heard in enumerate(onsets):
            heard = heard[heard < end]
            consistent = synchrony.beat_consistency(beats[beats < end], heard)
            there = ends[ends < end]
            matched = 100 * synchrony.matches(there, synchrony.spaced(heard)) / len(there)
            scores[i == j].append((consistent, matched))
    own, other = np.mean(scores[True], 0), np.mean(scores[False], 0)
    assert own[0] - other[0] > 0.15
    assert own[1] - other[1] > 20
