"""Frechet distances in closed form, against scipy's root, and with more dimensions than windows."""

import numpy as np
import pytest
import scipy.linalg
from sklearn.covariance import ledoit_wolf

from angie.metrics import frechet


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def test_a_set_is_at_no_distance_from_itself(rng):
    rows = rng.normal(size=(40, 8))
    assert frechet.feature_distance(rows, rows).value == 0
    for shrinkage in frechet.SHRINKAGES:
        wide = rng.normal(size=(30, 200))
        assert frechet.raw_distance(wide, wide, shrinkage).value == pytest.approx(0, abs=1e-9)


def test_one_dimension_by_hand():
    # means 0 and 3, deviations 1 and 2: 9 + (1 - 2)^2
    real, made = np.array([[-1.0], [0.0], [1.0]]), np.array([[1.0], [3.0], [5.0]])
    assert frechet.feature_distance(np.c_[real, real], np.c_[made, made]).value == pytest.approx(20)
    assert frechet.feature_distance(real, made).value == pytest.approx(10)


def test_the_root_is_that_of_scipy(rng):
    first, second = rng.normal(size=(2, 20, 32))  # rank 19 of 32
    covariances = [np.cov(rows, rowvar=False) for rows in (first, second)]
    root = np.trace(scipy.linalg.sqrtm(covariances[0] @ covariances[1]).real)
    apart = ((first.mean(0) - second.mean(0)) ** 2).sum()
    wanted = apart + sum(np.trace(c) for c in covariances) - 2 * root
    assert frechet.feature_distance(first, second).value == pytest.approx(wanted, abs=1e-6)


def test_few_windows_are_warned_of_and_one_is_refused(rng):
    assert "320 are wanted" in frechet.feature_distance(*rng.normal(size=(2, 319, 32))).warning
    assert frechet.feature_distance(*rng.normal(size=(2, 320, 32))).warning == ""
    one = frechet.feature_distance(rng.normal(size=(40, 4)), np.zeros((1, 4)))
    assert one.value is None and "fewer than two windows" in one.reason
    broken = frechet.raw_distance(rng.normal(size=(40, 4)), np.full((40, 4), np.nan))
    assert broken.value is None and "not finite" in broken.reason


def test_ledoit_wolf_is_that_of_scikit_learn(rng):
    for shape in ((30, 8), (20, 100)):
        rows = rng.normal(size=shape) * np.linspace(0.5, 2, shape[1])
        share, mean = frechet.ledoit_wolf(rows)
        fitted, wanted = ledoit_wolf(rows)
        assert share == pytest.approx(wanted)
        scaled = (len(rows) - 1) / len(rows)  # that one is biased
        assert mean * scaled == pytest.approx(np.trace(fitted) / shape[1])


def test_ledoit_wolf_outside_of_the_span_of_the_windows(rng):
    # against the same covariances written out in full
    first, second = rng.normal(size=(12, 40)), rng.normal(size=(15, 40)) * 1.5 + 0.2
    full = []
    for rows in (first, second):
        share, mean = frechet.ledoit_wolf(rows)
        full.append((1 - share) * np.cov(rows, rowvar=False) + share * mean * np.eye(40))
    wanted = frechet.distance(first.mean(0), full[0], second.mean(0), full[1])
    assert frechet.raw_distance(first, second, "ledoit-wolf").value == pytest.approx(wanted)


def test_rows_without_deviation_have_nothing_to_shrink():
    assert frechet.ledoit_wolf(np.ones((5, 3))) == (0.0, 0.0)


def test_principal_components_are_at_most_a_tenth_of_the_windows_and_64(rng):
    rows = rng.normal(size=(50, 300))
    assert frechet.raw_distance(rows, rows).counts["components"] == 5
    many = rng.normal(size=(700, 80))
    assert frechet.raw_distance(many, many).counts["components"] == 64
    shifted = rows + 3 * frechet.principal(rows, 1).T
    assert frechet.raw_distance(rows, shifted).value == pytest.approx(9)
    with pytest.raises(ValueError, match="pca, ledoit-wolf"):
        frechet.raw_distance(rows, rows, "none")
