"""Diversity of motion by its published definitions; no score of quality, noise is diverse too."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from angie.metrics.score import Score, not_finite

PAIRS = 500
"""Pairs of windows that are compared (HA2G)."""

MOST_WINDOWS = 2000
"""Windows of which all pairs are compared, at most; more are thinned out at random."""


def shuffled(features: NDArray, seed: int = 0) -> Score:
    """Diversity (HA2G, Liu et al. 2022, released code): mean L1 distance to shuffled features.

    The first 500 features against 500 drawn without repetition; a feature may meet itself, and
    neighbouring windows of a clip. L1 is summed over the feature's numbers.

    Args:
        features: (n, d) of windows in order.
        seed: of the permutation.
    """
    features = np.asarray(features, np.float64)
    broken = not_finite([features])
    if broken is not None:
        return broken
    count = min(len(features), PAIRS)
    if count < 2:
        return Score.missing("fewer than two windows; longer clips are needed", windows=count)
    other = np.random.default_rng(seed).permutation(len(features))[:count]
    value = np.abs(features[:count] - features[other]).sum(1).mean()
    return Score(float(value), counts={"windows": len(features), "pairs": count})


def across_clips(features: NDArray, clips: Sequence[int] | NDArray, seed: int = 0) -> Score:
    """Mean L1 distance of up to 500 random pairs of windows of different clips, each used once.

    HA2G's diversity without its two accidents (see `shuffled`).

    Args:
        features: (n, d) of windows.
        clips: (n,) number of the clip that each is of.
        seed: of the pairs.
    """
    features, clips = np.asarray(features, np.float64), np.asarray(clips)
    broken = not_finite([features])
    if broken is not None:
        return broken
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


def pairwise(rows: NDArray, seed: int = 0) -> Score:
    """Mean Euclidean distance of all pairs of windows (Bailando; QPGesture).

    QPGesture's feature diversity for features, its raw diversity for flattened windows.

    Args:
        rows: (n, d) features or flattened windows.
        seed: of the choice of 2000 windows, where there are more.
    """
    rows = np.asarray(rows, np.float64)
    broken = not_finite([rows])
    if broken is not None:
        return broken
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


def lexeme_entropy(codes: NDArray, size: int) -> Score:
    """Entropy -sum p log p of codes in nat (Rhythmic Gesticulator, Ao et al. 2022, equation 23).

    Args:
        codes: integers in [0, size), any shape.
        size: number of codes there are.
    """
    codes = np.asarray(codes).reshape(-1)
    if not len(codes):
        return Score.missing("no codes", codes=0)
    share = np.bincount(codes, minlength=size) / len(codes)
    share = share[share > 0]
    return Score(
        float(-(share * np.log(share)).sum()), counts={"codes": len(codes), "different": len(share)}
    )
