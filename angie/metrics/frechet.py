"""Frechet distance of two sets of vectors, in float64 by symmetric eigenvalues.

`|m1 - m2|^2 + Tr(S1 + S2 - 2 (S1 S2)^(1/2))` with unbiased covariances. The trace of the root is
the sum of the roots of the eigenvalues of `S1^(1/2) S2 S1^(1/2)`, clipped at 0: real where the
covariances lack full rank and a general matrix root gives complex noise. Where that fails to
converge, 1e-6 is added to the diagonals.
"""

import numpy as np
from numpy.typing import NDArray

from angie.metrics.score import Score

ENOUGH = 10
"""Windows for each feature below which a Frechet distance is to be read with care."""

RIDGE = 1e-6
"""Added to the diagonals when the eigenvalues cannot be computed otherwise."""

MOST_COMPONENTS = 64
"""Principal components of the raw space, at most; and at most a tenth of the windows."""

SHRINKAGES = ("pca", "ledoit-wolf")


def _trace_of_root(first: NDArray, second: NDArray) -> float:
    """Tr (S1 S2)^(1/2) of symmetric positive semidefinite matrices (d, d)."""
    values, vectors = np.linalg.eigh(first)
    half = (vectors * np.sqrt(values.clip(0))) @ vectors.T
    product = half @ second @ half
    values = np.linalg.eigvalsh((product + product.T) / 2)
    return float(np.sqrt(values.clip(0)).sum())


def distance(first_mean: NDArray, first: NDArray, second_mean: NDArray, second: NDArray) -> float:
    """Frechet distance of two Gaussians, means (d,) and covariances (d, d); 0 when equal.

    Rounding can leave a tiny negative number, which becomes 0.
    """
    apart = float(((first_mean - second_mean) ** 2).sum())
    if np.array_equal(first, second):
        return apart  # the roots of rounding errors would not be 0
    try:
        root = _trace_of_root(first, second)
    except np.linalg.LinAlgError:
        ridge = RIDGE * np.eye(len(first))
        first, second = first + ridge, second + ridge
        root = _trace_of_root(first, second)
    return max(apart + float(np.trace(first) + np.trace(second)) - 2 * root, 0.0)


def _too_few(real: NDArray, made: NDArray) -> Score | None:
    counts = {"windows": len(made), "real windows": len(real)}
    if min(len(real), len(made)) < 2:
        return Score.missing("fewer than two windows; longer clips are needed", **counts)
    if not (np.isfinite(real).all() and np.isfinite(made).all()):
        return Score.missing("windows hold numbers that are not finite", **counts)
    return None


def _warning(windows: int, width: int) -> str:
    if windows >= ENOUGH * width:
        return ""
    return f"{windows} windows for {width} features; {ENOUGH * width} are wanted"


def feature_distance(real: NDArray, made: NDArray) -> Score:
    """FGD of features (n, d) and (m, d) (TriCon, Yoon et al. 2020); lower is better."""
    real, made = np.asarray(real, np.float64), np.asarray(made, np.float64)
    missing = _too_few(real, made)
    if missing is not None:
        return missing
    first, second = (np.atleast_2d(np.cov(rows, rowvar=False)) for rows in (real, made))
    value = distance(real.mean(0), first, made.mean(0), second)
    counts = {"windows": len(made), "real windows": len(real), "features": real.shape[1]}
    return Score(value, counts=counts, warning=_warning(min(len(real), len(made)), real.shape[1]))


def raw_distance(real: NDArray, made: NDArray, shrinkage: str = "pca") -> Score:
    """Frechet distance of flattened windows (n, d) and (m, d), d far above n; lower is better.

    - "pca": on the first min(n / 10, 64) principal components of the recorded windows (at least
      2). What leaves their span is not seen.
    - "ledoit-wolf": with the covariances of Ledoit and Wolf (2004), exact and without a matrix of
      (d, d): outside of the span of the windows both covariances are multiples of the identity.
      The cost grows with the cube of n + m and the square of d.

    Args:
        real: windows of recorded motion.
        made: windows of the motion to be scored.
        shrinkage: one of `SHRINKAGES`.
    """
    if shrinkage not in SHRINKAGES:
        raise ValueError(f"shrinkage is one of {', '.join(SHRINKAGES)}, not {shrinkage!r}")
    real, made = np.asarray(real, np.float64), np.asarray(made, np.float64)
    missing = _too_few(real, made)
    if missing is not None:
        return missing
    counts = {"windows": len(made), "real windows": len(real)}
    if shrinkage == "ledoit-wolf":
        return Score(_shrunk_distance(real, made), counts=counts)
    basis = principal(real, min(max(len(real) // 10, 2), MOST_COMPONENTS))
    score = feature_distance(real @ basis, made @ basis)
    return Score(score.value, score.reason, {**counts, "components": basis.shape[1]}, score.warning)


def principal(rows: NDArray, count: int) -> NDArray:
    """The first `count` principal directions (d, count) of rows (n, d), count below n."""
    _, _, directions = np.linalg.svd(rows - rows.mean(0), full_matrices=False)
    return directions[:count].T


def ledoit_wolf(rows: NDArray) -> tuple[float, float]:
    """Shrinkage of Ledoit and Wolf (2004) for the covariance of rows (n, d).

    Returns:
        a and m of `(1 - a) S + a m I`, S the unbiased covariance, m = Tr S / d. The a is that of
        the biased covariance, as in the paper; 0 for rows without any deviation.
    """
    from sklearn.covariance import ledoit_wolf_shrinkage  # slow to import

    return float(ledoit_wolf_shrinkage(rows)), float(rows.var(axis=0, ddof=1).mean())


def _shrunk_distance(real: NDArray, made: NDArray) -> float:
    """Frechet distance of Ledoit-Wolf covariances in the span of both sets and outside of it."""
    means = real.mean(0), made.mean(0)
    centred = [rows - mean for rows, mean in zip((real, made), means, strict=True)]
    _, sizes, directions = np.linalg.svd(np.concatenate(centred), full_matrices=False)
    span = directions[sizes > 1e-9 * max(float(sizes.max()), 1e-30)].T  # (d, r)
    inside, outside = [], []
    for rows in centred:
        share, mean = ledoit_wolf(rows)
        own = rows @ span
        inside.append(
            (1 - share) * own.T @ own / (len(own) - 1) + share * mean * np.eye(len(own.T))
        )
        outside.append(share * mean)
    rest = real.shape[1] - span.shape[1]
    beyond = rest * (np.sqrt(outside[0]) - np.sqrt(outside[1])) ** 2
    zero = np.zeros(span.shape[1])
    return float(
        ((means[0] - means[1]) ** 2).sum() + distance(zero, inside[0], zero, inside[1]) + beyond
    )
