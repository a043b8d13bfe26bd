"""How well motion keeps time with sound: motion beats, beat consistency, matched beats.

Both scores compare beats of the motion, moments at which what moves comes to rest or turns, with
onsets of the sound. Motion is that of any points (joints, active regions) in any unit, at any
frame rate; sound is the times of its onsets in seconds.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

PROMINENCE = 0.03
"""By how much a neighbour of a motion beat must exceed it, in units of the mean activity."""

SIGMA = 0.1
"""Seconds at which beat consistency counts exp(-1/2)."""

NEAR = 0.2
"""Seconds within which two beats match."""

SPACING = 0.2
"""Seconds below which an onset does not count after another (Rhythmic Gesticulator, D_m)."""

SMOOTH = 0.05
"""Seconds of the Gaussian that smooths speed for matched beats: one frame at 20 a second."""


def steps(points: NDArray) -> NDArray:
    """Distances (T, n) that points (T, n, D) go in the frame before each, first row zero."""
    moved = np.linalg.norm(np.diff(points.astype(np.float64), axis=0), axis=-1)
    return np.concatenate([np.zeros((1, points.shape[1])), moved])


def activity(changes: NDArray, usual: NDArray) -> NDArray:
    """Curve (T,) of mean 1 over the data: changes (T, n) over their usual size (n,), averaged."""
    return (changes / usual).mean(1)


def minima(curve: NDArray, fps: float, prominence: float = PROMINENCE) -> NDArray:
    """Times (m,) in seconds of the local minima of a curve (T,) of `fps` values a second.

    A minimum lies below both neighbours, and below one of them by `prominence` or more; the
    first two and the last frame have none (HA2G, released code).
    """
    middle, before, after = curve[2:-1], curve[1:-2], curve[3:]
    lowest = (middle < before) & (middle < after)
    deep = np.maximum(before, after) - middle >= prominence
    return (np.flatnonzero(lowest & deep) + 2) / fps


def beat_consistency(motion: NDArray, sound: NDArray, sigma: float = SIGMA) -> float:
    """Mean over the onsets of a sound of exp(-d^2 / (2 sigma^2)), d to the nearest motion beat.

    HA2G (Liu et al. 2022), released code.

    Args:
        motion: beats (m,) in seconds, m above 0.
        sound: onsets (n,) in seconds, n above 0.
        sigma: seconds.
    """
    away = np.abs(sound[:, None] - motion).min(1)
    return float(np.exp(-(away**2) / (2 * sigma**2)).mean())


def smooth_minima(curve: NDArray, fps: float) -> NDArray:
    """Motion beats (m,) of the percentage of matched beats: ends of deceleration, seconds.

    Args:
        curve: speed (T,) in any unit, of the step before each frame as `steps` has it; the first
            frame has none, and what stands there is not read.
        fps: values a second.
    """
    moved = curve[1:]
    if len(moved) < 4:
        return np.zeros(0)  # a minimum has neighbours, and three frames at the ends have none
    smooth = gaussian_filter1d(moved, SMOOTH * fps)
    return minima(smooth, fps, PROMINENCE * float(moved.mean())) + 1 / fps


def spaced(sound: NDArray) -> NDArray:
    """Onsets without those that follow another that counts by less than `SPACING`."""
    kept: list[float] = []
    for onset in sound:
        if not kept or onset - kept[-1] >= SPACING - 1e-6:
            kept.append(float(onset))
    return np.array(kept)


def matches(motion: NDArray, sound: NDArray, near: float = NEAR) -> int:
    """Number of motion beats less than `near` seconds from an onset of their own.

    In order, each onset counts once (Rhythmic Gesticulator, Ao et al. 2022, after Ho et al. 2013).

    Args:
        motion: beats (m,) in seconds, in order.
        sound: onsets (n,) in seconds, in order, as `spaced` leaves them.
        near: seconds.
    """
    matched, free = 0, 0
    for beat in motion:
        candidates = np.flatnonzero(np.abs(sound[free:] - beat) < near)
        if len(candidates):
            matched += 1
            free += int(candidates[0]) + 1
    return matched
