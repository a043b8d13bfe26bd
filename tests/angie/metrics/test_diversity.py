"""Diversity by hand."""

import numpy as np
import pytest

from angie.metrics import diversity


def test_shuffled_features_by_hand():
    features = np.array([[0.0, 0.0], [1.0, 2.0]])
    other = np.random.default_rng(3).permutation(2)
    wanted = 0 if other.tolist() == [0, 1] else 3
    assert diversity.shuffled(features, seed=3).value == wanted
    assert {diversity.shuffled(features, seed=s).value for s in range(9)} == {0.0, 3.0}
    assert diversity.shuffled(features[:1]).value is None


def test_pairs_are_of_different_clips_and_each_window_is_used_once():
    clips = np.repeat([0, 1, 2], [40, 7, 5])
    pairs = diversity._disjoint_pairs(clips, seed=1)
    assert len(set(pairs.ravel().tolist())) == 2 * len(pairs) > 12
    assert (clips[pairs[:, 0]] != clips[pairs[:, 1]]).all()
    features = clips[:, None] * np.ones(3)
    far = diversity.across_clips(features * [1, 10, 100], clips % 2, seed=1)
    assert 1 <= far.value <= 2 * 111 and far.counts["windows"] == 52
    assert diversity.across_clips(features, np.zeros(52, int)).value is None
    two = diversity.across_clips(np.array([[0.0, 0], [0, 0], [3, 4], [3, 4]]), [0, 0, 1, 1])
    assert two.value == 7 and two.counts["pairs"] == 2


def test_at_most_500_pairs():
    rng = np.random.default_rng(0)
    assert (
        diversity.across_clips(rng.normal(size=(1400, 2)), np.arange(1400)).counts["pairs"] == 500
    )
    assert diversity.shuffled(rng.normal(size=(1400, 2))).counts["pairs"] == 500


def test_pairwise_distance_by_hand():
    corners = np.array([[0.0, 0.0], [3.0, 0.0], [0.0, 4.0]])
    assert diversity.pairwise(corners).value == pytest.approx(4)  # 3, 4 and 5
    assert diversity.pairwise(np.ones((5, 3))).value == pytest.approx(0)
    assert diversity.pairwise(corners[:1]).value is None
    many = np.random.default_rng(0).normal(size=(2100, 2))
    assert diversity.pairwise(many).counts["pairs"] == 1999 * 1000


@pytest.mark.parametrize("hole", [np.nan, np.inf])
def test_windows_that_are_not_finite_are_told(hole):
    features = np.ones((20, 3))
    features[4, 1] = hole
    for score in (
        diversity.shuffled(features),
        diversity.across_clips(features, np.arange(20)),
        diversity.pairwise(features),
    ):
        assert (score.value, score.reason) == (None, "motion is not finite")
