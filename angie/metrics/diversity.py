"""Diversity of motion by its published definitions; no score of quality, noise is diverse too.

Smoothness and speed: jerk, acceleration, Hellinger distance of speed histograms.

All are closest to the truth at the truth's own value, not at their largest or smallest.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from angie.metrics.score import Score, finite
from data_prep.speech.synchrony import steps

PAIRS = 500
"""Pairs of windows that are compared (HA2G)."""


MOST_WINDOWS = 2000
"""Windows of which all pairs are compared, at most; more are thinned out at random."""


@finite()
def shuffled(features: NDArray, seed: int = 0) -> Score:
    """Diversity (HA2G, Liu et al. 2022, released code): mean L1 distance to shuffled features.

    The first 500 features against 500 drawn without repetition; a feature may meet itself, and
    neighbouring windows of a clip. L1 is summed over the feature's numbers.

    Args:
        features: (n, d) of windows in order.
        seed: of the permutation.
    """
    features = np.asarray(features, np.float64)
    count = min(len(features), PAIRS)
    if count < 2:
        return Score.missing("fewer than two windows; longer clips are needed", windows=count)
    other = np.random.default_rng(seed).permutation(len(features))[:count]
    value = np.abs(features[:count] - features[other]).sum(1).mean()
    return Score(float(value), counts={"windows": len(features), "pairs": count})


@finite()
def across_clips(features: NDArray, clips: Sequence[int] | NDArray, seed: int = 0) -> Score:
    """Mean L1 distance of up to 500 random pairs of windows of different clips, each used once.

    HA2G's diversity without its two accidents (see `shuffled`).

    Args:
        features: (n, d) of windows.
        clips: (n,) number of the clip that each is of.
        seed: of the pairs.
    """
    features, clips = np.asarray(features, np.float64), np.asarray(clips)
    pairs = _disjoint_pairs(clips, seed)
    counts = {"windows": len(features), "pairs": len(pairs)}
    if not len(pairs):
        return Score.missing("no two windows of different clips", **counts)
    value = np.abs(features[pairs[:, 0]] - features[pairs[:, 1]]).sum(1).mean()
    return Score(float(value), counts=counts)


def _disjoint_pairs(clips: NDArray, seed: int) -> NDArray:
    """Pairs (p, 2) of different clips, p at most `PAIRS`, no index twice."""
    waiting: list[int] = []  # all of one clip
    pairs = []
    for index in np.random.default_rng(seed).permutation(len(clips)).tolist():
        if waiting and clips[waiting[-1]] != clips[index]:
            pairs.append((waiting.pop(), index))
        else:
            waiting.append(index)
    return np.array(pairs[:PAIRS], np.int64).reshape(-1, 2)


@finite()
def pairwise(rows: NDArray, seed: int = 0) -> Score:
    """Mean Euclidean distance of all pairs of windows (Bailando; QPGesture).

    QPGesture's feature diversity for features, its raw diversity for flattened windows.

    Args:
        rows: (n, d) features or flattened windows.
        seed: of the choice of 2000 windows, where there are more.
    """
    rows = np.asarray(rows, np.float64)
    windows = len(rows)
    if windows < 2:
        return Score.missing("fewer than two windows; longer clips are needed", windows=windows)
    if windows > MOST_WINDOWS:
        rows = rows[np.random.default_rng(seed).permutation(windows)[:MOST_WINDOWS]]
    rows = rows - rows.mean(0)
    square = (rows**2).sum(1)
    apart = np.sqrt((square[:, None] + square - 2 * rows @ rows.T).clip(0))
    first, second = np.triu_indices(len(rows), 1)
    return Score(
        float(apart[first, second].mean()), counts={"windows": windows, "pairs": len(first)}
    )


BINS = 60
"""Bins of a histogram (GENEA, released code), besides the one for what is faster."""


FASTEST = 99.5
"""Percentile of the true speed at which the bins end."""


@finite()
def derivative(points: Sequence[NDArray], fps: float, order: int) -> Score:
    """Mean size of a derivative: acceleration for order 2, jerk for order 3 (GENEA, Trimodal).

    The norm of the n-th finite difference times fps^n, averaged over frames and points of a clip;
    mean and standard deviation over clips.

    Args:
        points: (T, n, D) of each clip; clips of `order` frames or fewer are left out.
        fps: frames a second.
        order: of the derivative, at least 1.
    """
    values = [
        float(np.linalg.norm(np.diff(clip.astype(np.float64), order, axis=0), axis=-1).mean())
        * fps**order
        for clip in points
        if len(clip) > order
    ]
    counts = {"clips": len(values), "too short": len(points) - len(values)}
    if not values:
        return Score.missing(f"no clip has more than {order} frames", **counts)
    return Score(float(np.mean(values)), counts=counts, deviation=float(np.std(values)))


def jerk(points: Sequence[NDArray], fps: float) -> Score:
    """`derivative` of order 3, units of the points / s^3."""
    return derivative(points, fps, 3)


def acceleration(points: Sequence[NDArray], fps: float) -> Score:
    """`derivative` of order 2, units of the points / s^2."""
    return derivative(points, fps, 2)


@finite(2)
def hellinger(real: Sequence[NDArray], made: Sequence[NDArray], fps: float) -> Score:
    """Hellinger distance of speed histograms, 0 to 1 (GENEA, Kucherenko et al. 2020; QPGesture).

    For each point `sqrt(1 - sum_b sqrt(h1_b h2_b))`, then the mean over points. A histogram has
    60 bins from 0 to the 99.5th percentile of the point's true speed and one for what is faster,
    and sums to 1. (GENEA's bins are 1 cm/s wide; image regions have no centimetres.) A point that
    stands still in the truth has no bins; it is left out and counted.

    Args:
        real: recorded motion (T, n, D), of each clip.
        made: motion to be scored (T, n, D), of each clip.
        fps: frames a second.
    """
    speeds = [
        np.concatenate([steps(clip)[1:] for clip in clips]) * fps
        if len(clips)
        else np.zeros((0, 0))
        for clips in (real, made)
    ]
    counts = {"frames": len(speeds[1]), "real frames": len(speeds[0])}
    if not min(counts.values()):
        return Score.missing("no frames", **counts)
    values = []
    for true, own in zip(speeds[0].T, speeds[1].T, strict=True):
        fastest = float(np.percentile(true, FASTEST))
        if fastest > 0:
            edges = np.append(np.linspace(0, fastest, BINS + 1), np.inf)
            shares = [np.histogram(s, edges)[0] / len(s) for s in (true, own)]
            overlap = float(np.sqrt(shares[0] * shares[1]).sum())
            values.append(np.sqrt(max(1 - overlap, 0.0)))
    counts |= {"points": len(values), "still in truth": speeds[0].shape[1] - len(values)}
    if not values:
        return Score.missing("no point moves in the truth", **counts)
    return Score(float(np.mean(values)), counts=counts)
