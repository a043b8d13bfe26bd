"""MAJE, MAD and CCA by hand and against scikit-learn."""

import numpy as np
import pytest
from sklearn.cross_decomposition import CCA

from angie.metrics import truth


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def test_maje_is_the_mean_over_all_numbers():
    real, made = np.zeros((2, 1, 2)), np.array([[[1.0, 0]], [[0, 3.0]]])
    assert truth.maje([real], [made]).value == 1
    assert truth.maje([real, real[:1]], [made, real[:1]]).value == pytest.approx(2 / 3)
    assert truth.maje([real], [real]).value == 0
    assert truth.maje([], []).value is None
    with pytest.raises(ValueError, match="same shapes"):
        truth.maje([real], [made[:1]])


def test_mad_of_a_parabola_against_rest():
    at = np.arange(20) / 10
    real = np.stack([3 * at**2 / 2, 4 * at**2 / 2], axis=1)[:, None]  # acceleration (3, 4)
    assert truth.mad([real], [0 * real], 10).value == pytest.approx(5)
    assert truth.mad([real], [real + at[:, None, None]], 10).value == pytest.approx(0, abs=1e-9)
    assert truth.mad([real[:2]], [real[:2]], 10).value is None


def test_cca_of_identical_and_of_linearly_related_motion_is_1(rng):
    real = rng.normal(size=(200, 3, 2))
    assert truth.cca([real], [real]).value == pytest.approx(1)
    mixed = (real.reshape(200, 6) @ rng.normal(size=(6, 6))).reshape(200, 3, 2)
    assert truth.global_cca([real], [mixed]).value == pytest.approx(1)


def test_cca_is_that_of_scikit_learn(rng):
    real = rng.normal(size=(300, 4, 2))
    made = real[:, ::-1] * 0.5 + rng.normal(size=real.shape)
    flat = real.reshape(300, 8), made.reshape(300, 8)
    model = CCA(n_components=1, max_iter=5000, tol=1e-12).fit(*flat)
    variates = model.transform(*flat)
    wanted = np.corrcoef(variates[0][:, 0], variates[1][:, 0])[0, 1]
    assert truth.global_cca([real], [made]).value == pytest.approx(wanted, abs=1e-6)


def test_cca_is_fitted_clip_by_clip_or_once(rng):
    real = [rng.normal(size=(100, 1, 2)) for _ in range(2)]
    made = [real[0], -real[1]]  # each fully correlated, together not
    assert truth.cca(real, made).value == pytest.approx(1)
    assert truth.cca(real, made).deviation == pytest.approx(0, abs=1e-9)
    assert truth.global_cca(real, made).value < 0.5


def test_cca_tells_why_it_has_no_value(rng):
    real = rng.normal(size=(100, 2, 2))
    still = truth.cca([real], [0 * real])
    assert still.value is None and "no dimension varies" in still.reason
    assert truth.global_cca([real], [0 * real]).reason == "no dimension varies"
    short = truth.cca([real[:8]], [real[:8]])
    assert short.value is None and "as many dimensions as frames" in short.reason
    assert truth.cca([], []).value is None and truth.global_cca([], []).value is None
    # constant dimensions alone are dropped
    half = np.concatenate([real[:, :1], 0 * real[:, :1]], axis=1)
    assert truth.cca([half], [half]).value == pytest.approx(1)


def test_cca_of_few_frames_is_told_to_be_high_by_itself(rng):
    real, made = rng.normal(size=(2, 100, 2, 2))
    few, many = truth.global_cca([real[:30]], [made[:30]]), truth.global_cca([real], [made])
    assert few.warning.startswith("30 frames; 80 are wanted") and not many.warning
    assert few.value > many.value


@pytest.mark.parametrize("hole", [np.nan, np.inf])
def test_motion_that_is_not_finite_is_told(rng, hole):
    real = rng.normal(size=(30, 2, 2))
    made = real.copy()
    made[3] = hole
    for score in (
        truth.maje([real], [made]),
        truth.mad([made], [real], 25),
        truth.global_cca([real], [made]),
        truth.cca([real], [made]),
    ):
        assert (score.value, score.reason) == (None, "motion is not finite")
