"""Jerk and acceleration of powers of time; Hellinger distance at its extremes."""

import numpy as np
import pytest

from angie.metrics import diversity as speed


def moving(path) -> np.ndarray:
    """One point (T, 1, 2) along x."""
    return np.stack([path, np.zeros_like(path)], axis=1)[:, None]


@pytest.mark.parametrize("fps", [15, 25, 60])
def test_acceleration_of_a_square_and_jerk_of_a_cube_are_exact(fps):
    at = np.arange(30) / fps
    assert speed.acceleration([moving(at**2)], fps).value == pytest.approx(2)
    assert speed.jerk([moving(at**3)], fps).value == pytest.approx(6)
    assert speed.jerk([moving(at**2)], fps).value == pytest.approx(0, abs=1e-6)


def test_mean_and_deviation_are_over_clips():
    at = np.arange(50) / 25
    score = speed.acceleration([moving(at**2), moving(2 * at[:10] ** 2), moving(at[:2])], 25)
    assert score.value == pytest.approx(3) and score.deviation == pytest.approx(1)
    assert score.counts == {"clips": 2, "too short": 1}
    assert speed.jerk([moving(at[:3])], 25).value is None
    assert speed.jerk([moving(0 * at)], 25).value == 0


def test_hellinger_is_0_for_the_same_and_1_for_what_never_overlaps():
    rng = np.random.default_rng(0)
    slow = moving(np.cumsum(rng.uniform(0.1, 0.2, 200)))
    fast = moving(np.cumsum(rng.uniform(0.5, 0.6, 200)))
    assert speed.hellinger([slow], [slow], 25).value == 0
    assert speed.hellinger([fast], [slow], 25).value == pytest.approx(1)
    assert speed.hellinger([slow], [0 * slow], 25).value == pytest.approx(1)


def test_hellinger_by_hand():
    # speeds 1 and 3 in the truth, all 1 in the other: sqrt(1 - sqrt(1/2))
    true = moving(np.cumsum([0.0, 1, 3, 1, 3]))
    other = moving(np.cumsum([0.0, 1, 1, 1, 1]))
    wanted = np.sqrt(1 - np.sqrt(0.5))
    assert speed.hellinger([true], [other], 1).value == pytest.approx(wanted)


def test_hellinger_leaves_out_what_stands_still_in_the_truth():
    true = moving(np.cumsum([0.0, 1, 3, 1, 3]))
    pair = np.concatenate([true, 0 * true], axis=1)
    score = speed.hellinger([pair], [pair], 25)
    assert score.value == 0 and score.counts["still in truth"] == 1
    assert speed.hellinger([0 * true], [true], 25).value is None
    assert speed.hellinger([], [], 25).value is None


def test_motion_that_is_not_finite_is_told():
    whole, broken = (moving(np.sin(np.arange(60.0))) for _ in range(2))
    broken[10] = np.nan
    for score in (
        speed.hellinger([whole], [broken], 25),
        speed.hellinger([broken], [whole], 25),
        speed.jerk([whole, broken], 25),
        speed.acceleration([broken], 25),
    ):
        assert (score.value, score.reason) == (None, "motion is not finite")
