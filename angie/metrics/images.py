"""Frames against recorded frames: AED, AKD, MKR, flicker.

L1, perceptual distance, SSIM and PSNR are in `mraa.image_metrics`. The networks behind embeddings
and key points are arguments: the ones trained here (`identity`, the region estimator), or any
other whose results are stored in an .npz file.
"""

import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from angie.metrics.score import Score
from data_prep.errors import BadInput


def aed(real: Sequence[NDArray], made: Sequence[NDArray]) -> Score:
    """Average "Euclidean" distance of identity embeddings (FOMM and MRAA): mean |e - e'|.

    The tool of those papers takes the mean absolute difference, whatever the name says.

    Args:
        real: (T, E) embeddings of the frames of each recorded clip.
        made: of the same shapes.
    """
    if any(a.shape != b.shape for a, b in zip(real, made, strict=True)):
        raise ValueError("recorded and made embeddings must have the same shapes")
    apart = [np.abs(a.astype(np.float64) - b).mean(1) for a, b in zip(real, made, strict=True)]
    frames = sum(len(part) for part in apart)
    if not frames:
        return Score.missing("no frames", frames=0)
    return Score(float(np.concatenate(apart).mean()), counts={"frames": frames})


def _seen(points: NDArray) -> NDArray:
    return np.isfinite(points).all(axis=-1)


def akd(real: Sequence[NDArray], made: Sequence[NDArray]) -> Score:
    """Average key point distance (FOMM and MRAA): mean |p - p'| over points seen in both.

    Args:
        real: (T, n, D) points of the recorded frames of each clip; NaN where none was found.
        made: of the same shapes.
    """
    total, count, unseen = 0.0, 0, 0
    for a, b in zip(real, made, strict=True):
        both = _seen(a) & _seen(b)
        total += float(np.abs(a[both].astype(np.float64) - b[both]).sum())
        count += int(both.sum()) * a.shape[-1]
        unseen += int((~both).sum())
    if not count:
        return Score.missing("no key point is seen in both", points=0, unseen=unseen)
    return Score(total / count, counts={"numbers": count, "unseen": unseen})


def mkr(real: Sequence[NDArray], made: Sequence[NDArray]) -> Score:
    """Missing key point rate (FOMM and MRAA): share of points seen in the truth alone, 0 to 1.

    Args:
        real: (T, n, D) points of the recorded frames of each clip; NaN where none was found.
        made: of the same shapes.
    """
    there = sum(int(_seen(a).sum()) for a in real)
    if not there:
        return Score.missing("no key point is seen in the truth", points=0)
    lost = sum(int((_seen(a) & ~_seen(b)).sum()) for a, b in zip(real, made, strict=True))
    return Score(lost / there, counts={"points": there, "missing": lost})


def flicker(real: NDArray, made: NDArray) -> float:
    """Mean |dI_t - dI'_t| of frames (T, H, W, 3) in [0, 1], T above 1, d from frame to frame.

    0 also for a made clip that is off by a constant picture; it measures flicker alone.
    """
    return float(np.abs(np.diff(real, axis=0) - np.diff(made, axis=0)).mean())


def read_pair(path: Path, name: str) -> tuple[NDArray, NDArray] | None:
    """Arrays `real_<name>` and `made_<name>` of an .npz file, of another network or detector.

    Args:
        path: the file.
        name: "embeddings" (T, E), or "points" (T, n, 2) in pixels, NaN where none was found.

    Returns:
        the recorded frames' and the made frames' array, cut to the shorter; None where the file
        has neither.

    Raises:
        BadInput: unreadable, one of the two alone, not floats, of different shapes, or embeddings
            that are not finite.
    """
    names = [f"{side}_{name}" for side in ("real", "made")]
    try:
        with np.load(path, allow_pickle=False) as file:
            found = [file[key] for key in names if key in file.files]
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise BadInput(f"{path}: is no .npz file that can be read ({error})") from error
    if not found:
        return None
    if len(found) == 1:
        raise BadInput(f"{path}: has {names[0]} or {names[1]} alone; both are needed")
    rank = 2 if name == "embeddings" else 3
    real, made = found
    if {real.ndim, made.ndim} != {rank} or real.shape[1:] != made.shape[1:]:
        raise BadInput(f"{path}: {name} have shapes {real.shape} and {made.shape}")
    if not all(np.issubdtype(values.dtype, np.floating) for values in found):
        raise BadInput(f"{path}: {name} must be floating-point numbers")
    if name == "embeddings" and not all(np.isfinite(values).all() for values in found):
        raise BadInput(f"{path}: {name} must be finite numbers")
    frames = min(len(real), len(made))
    return real[:frames], made[:frames]
