"""Distance to the motion that was recorded with the sound: MAJE, MAD, CCA.

Many gestures suit one speech, so these favour the mean gesture; FGD and the beat scores do not.

`real` are the recorded points (T, n, D) of each clip, `made` generated ones of the same shapes.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from angie.metrics.score import Score, finite

ENOUGH = 10
"""Frames for each dimension that CCA over all clips wants; fewer correlate by themselves."""

CONSTANT = 1e-8
"""Standard deviation up to which a dimension counts as constant and is dropped from CCA."""


def _pairs(real: Sequence[NDArray], made: Sequence[NDArray]) -> list[tuple[NDArray, NDArray]]:
    pairs = list(zip(real, made, strict=True))
    if any(a.shape != b.shape for a, b in pairs):
        raise ValueError("recorded and generated motion must have the same shapes")
    return [(a.astype(np.float64), b.astype(np.float64)) for a, b in pairs]


@finite(2)
def maje(real: Sequence[NDArray], made: Sequence[NDArray]) -> Score:
    """Mean absolute joint error: mean |p - p'| over frames, points and coordinates (TriCon)."""
    pairs = _pairs(real, made)
    frames = sum(len(a) for a, _ in pairs)
    if not frames:
        return Score.missing("no frames", frames=0)
    total = sum(float(np.abs(a - b).mean(axis=(1, 2)).sum()) for a, b in pairs)
    return Score(total / frames, counts={"frames": frames})


@finite(2)
def mad(real: Sequence[NDArray], made: Sequence[NDArray], fps: float) -> Score:
    """Mean acceleration difference: mean |a - a'| over frames and points, units / s^2.

    Euclidean norm of second differences times fps^2 (Rhythmic Gesticulator, Ao et al. 2022;
    RACER).

    Clips of 2 frames or fewer are left out.
    """
    apart = [np.diff(a - b, 2, axis=0) for a, b in _pairs(real, made)]
    frames = sum(len(change) for change in apart)
    if not frames:
        return Score.missing("no clip has more than 2 frames", frames=0)
    sizes = [np.linalg.norm(change, axis=-1).mean(1) * fps**2 for change in apart]
    return Score(float(np.concatenate(sizes).mean()), counts={"frames": frames})


def _basis(rows: NDArray) -> NDArray:
    """Orthonormal basis (T, r) of the centred columns of (T, d) that are not constant."""
    rows = rows[:, rows.std(axis=0) > CONSTANT]
    if not rows.shape[1]:
        return rows
    scaled = (rows - rows.mean(0)) / rows.std(axis=0)
    return linalg.orth(scaled, rcond=1e-10)


def canonical_correlation(first: NDArray, second: NDArray) -> float | str:
    """Largest canonical correlation of rows (T, d) and (T, e), or why there is none.

    It is the cosine of the smallest angle between the subspaces that their columns span (Bjorck
    and Golub 1973), which is the Pearson correlation of the first pair of canonical variates.
    """
    one, two = _basis(first), _basis(second)
    if not one.shape[1] or not two.shape[1]:
        return "no dimension varies"
    if one.shape[1] + two.shape[1] >= len(first):
        return "as many dimensions as frames"  # any two sets of so few frames correlate fully
    return float(np.cos(linalg.subspace_angles(one, two).min()))


@finite(2)
def global_cca(real: Sequence[NDArray], made: Sequence[NDArray]) -> Score:
    """First canonical correlation over the frames of all clips (GENEA; QPGesture "global CCA")."""
    pairs = _pairs(real, made)
    frames = sum(len(a) for a, _ in pairs)
    if not frames:
        return Score.missing("no frames", frames=0)
    stacked = [
        np.concatenate([p[side].reshape(len(p[side]), -1) for p in pairs]) for side in (0, 1)
    ]
    value = canonical_correlation(*stacked)
    if isinstance(value, str):
        return Score.missing(value, frames=frames)
    wanted = ENOUGH * sum(part.shape[1] for part in stacked)
    few = f"{frames} frames; {wanted} are wanted, fewer correlate by themselves"
    return Score(value, counts={"frames": frames}, warning="" if frames >= wanted else few)


@finite(2)
def cca(real: Sequence[NDArray], made: Sequence[NDArray]) -> Score:
    """First canonical correlation of each clip, mean and deviation over clips (GENEA; QPGesture).

    The correlation is fitted to each clip anew, as the released code does; high values are
    therefore easy to reach in short clips.
    """
    values: list[float] = []
    reasons: list[str] = []
    for a, b in _pairs(real, made):
        value = canonical_correlation(a.reshape(len(a), -1), b.reshape(len(b), -1))
        (reasons if isinstance(value, str) else values).append(value)  # type: ignore[arg-type]
    counts = {"clips": len(values), "left out": len(reasons)}
    if not values:
        why = f" ({', '.join(sorted(set(reasons)))})" if reasons else ""
        return Score.missing(f"no clip can be scored{why}", **counts)
    return Score(float(np.mean(values)), counts=counts, deviation=float(np.std(values)))
