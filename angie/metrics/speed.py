"""Smoothness and speed: jerk, acceleration, Hellinger distance of speed histograms.

All are closest to the truth at the truth's own value, not at their largest or smallest.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from angie.metrics.score import Score, not_finite
from data_prep.synchrony import steps

BINS = 60
"""Bins of a histogram (GENEA, released code), besides the one for what is faster."""

FASTEST = 99.5
"""Percentile of the true speed at which the bins end."""


def derivative(points: Sequence[NDArray], fps: float, order: int) -> Score:
    """Mean size of a derivative: acceleration for order 2, jerk for order 3 (GENEA, Trimodal).

    The norm of the n-th finite difference times fps^n, averaged over frames and points of a clip;
    mean and standard deviation over clips.

    Args:
        points: (T, n, D) of each clip; clips of `order` frames or fewer are left out.
        fps: frames a second.
        order: of the derivative, at least 1.
    """
    broken = not_finite(points)
    if broken is not None:
        return broken
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
    broken = not_finite(real, made)
    if broken is not None:
        return broken
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
