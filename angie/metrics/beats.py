"""Motion beats against onsets of speech: beat consistency, matched beats, Beat Align.

Points `(T, n, D)` are those that gesture: the active regions, or wrists and hands. Each list holds
one entry a clip; onsets are seconds from the clip's first frame. A clip without onsets (silence)
or without motion beats (a still person) cannot be scored; it is left out and counted.
"""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.signal import argrelextrema

from angie.metrics.score import Score, finite
from data_prep.speech.synchrony import (
    NEAR,
    activity,
    beat_consistency,
    matches,
    minima,
    smooth_minima,
    spaced,
    steps,
)

CURVE = tuple(round(0.05 * i, 2) for i in range(1, 11))
"""Thresholds in seconds of the curve of matched beats: 0.05 to 0.5."""

ALIGN_SIGMA = 0.05
"""Seconds: 3 frames at 60 a second (AIST++ and Bailando, released code)."""

ALIGN_SMOOTH = 5 / 60
"""Seconds of the Gaussian over Bailando's velocity: 5 frames at 60 a second."""


Pairs = list[tuple[NDArray, NDArray]]


def _beats(
    points: Sequence[NDArray], onsets: Sequence[NDArray], beats_of: Callable[[NDArray], NDArray]
) -> tuple[Pairs, dict[str, int], str]:
    """Motion beats and onsets of the clips that have both, the numbers of clips, and what lacks."""
    beats = [beats_of(clip) for clip in points]
    pairs = [(b, o) for b, o in zip(beats, onsets, strict=True) if len(b) and len(o)]
    silent = sum(not len(sound) for sound in onsets)
    left = {"without motion beats": len(beats) - len(pairs) - silent, "without onsets": silent}
    why = ", ".join(f"{count} {what}" for what, count in left.items() if count)
    reason = f"no clip can be scored ({why})" if why else "no clips"
    return pairs, {"clips": len(pairs), **left}, reason


def usual_steps(points: Sequence[NDArray]) -> NDArray:
    """Mean distance (n,) that each point goes in a frame, over clips of points (T, n, D)."""
    return np.concatenate([steps(clip)[1:] for clip in points]).mean(0)


@finite()
def consistency(
    points: Sequence[NDArray], onsets: Sequence[NDArray], usual: NDArray, fps: float
) -> Score:
    """Beat consistency, BC (HA2G, Liu et al. 2022, released code); higher is better, at most 1.

    Activity `a(t) = mean_k |x_k(t) - x_k(t-1)| / usual_k` stands for HA2G's mean change of the
    arms' angles, both of mean 1 over the training data. Motion beats are its local minima that a
    neighbouring frame exceeds by 0.03 (so that more frames a second give fewer beats). The score
    is the mean over onsets of `exp(-min_j (t - t_j)^2 / (2 sigma^2))`, sigma 0.1 s, pooled over
    clips, so that a clip weighs as much as it has onsets.

    Args:
        points: (T, n, D) of each clip.
        onsets: (m,) of each clip, seconds.
        usual: (n,) mean step of the points over training data, above 0.
        fps: frames a second.
    """
    pairs, counts, reason = _beats(
        points, onsets, lambda clip: minima(activity(steps(clip), usual), fps)
    )
    if not pairs:
        return Score.missing(reason, **counts)
    count = sum(len(sound) for _, sound in pairs)
    total = sum(beat_consistency(found, sound) * len(sound) for found, sound in pairs)
    return Score(total / count, counts={**counts, "onsets": count})


@finite()
def matched(
    points: Sequence[NDArray], onsets: Sequence[NDArray], fps: float, near: float = NEAR
) -> Score:
    """Percentage of matched beats, PMB (Rhythmic Gesticulator, Ao et al. 2022), 0 to 100.

    The share of motion beats less than `near` from an onset of their own, in order, each onset
    counting once; pooled over clips. Motion beats are the ends of deceleration: local minima of
    the mean speed, smoothed by a Gaussian of 0.05 s, of prominence 0.03 of its mean. Onsets count
    when they are at least 0.2 s apart.
    """
    pairs, counts, reason = _beats(
        points, onsets, lambda clip: smooth_minima(steps(clip).mean(1) * fps, fps)
    )
    if not pairs:
        return Score.missing(reason, **counts)
    hits = sum(matches(found, spaced(sound), near) for found, sound in pairs)
    beats = sum(len(found) for found, _ in pairs)
    return Score(100 * hits / beats, counts={**counts, "beats": beats, "matched": hits})


def matched_curve(
    points: Sequence[NDArray], onsets: Sequence[NDArray], fps: float
) -> dict[float, Score]:
    """PMB for each threshold of `CURVE`, seconds to score."""
    return {near: matched(points, onsets, fps, near) for near in CURVE}


def _aist_beats(clip: NDArray, fps: float) -> NDArray:
    speed = steps(clip)[1:].sum(1)
    return (argrelextrema(speed, np.less, order=max(1, round(fps / 6)))[0] + 1) / fps


def _bailando_beats(clip: NDArray, fps: float) -> NDArray:
    speed = gaussian_filter1d(steps(clip)[1:].mean(1), ALIGN_SMOOTH * fps)
    return (argrelextrema(speed, np.less)[0] + 1) / fps


@finite()
def align(
    points: Sequence[NDArray], onsets: Sequence[NDArray], fps: float, mode: str = "aist"
) -> Score:
    """Beat Align, mean over clips of a mean of exp(-d^2 / (2 sigma^2)), sigma 0.05 s; at most 1.

    - "aist" (AIST++, Li et al. 2021): d from every motion beat to the nearest onset. Motion beats
      are minima of the summed speed within round(fps / 6) frames (10 at 60 a second) on both sides.
    - "bailando" (Siyao et al. 2022, released code): d from every onset to the nearest motion
      beat. Motion beats are all strict minima of the mean speed, smoothed by a Gaussian of 5/60 s.

    Both are scores of dance; here onsets of speech take the place of the beats of music.

    Args:
        points: (T, n, D) of each clip.
        onsets: (m,) of each clip, seconds.
        fps: frames a second.
        mode: "aist" or "bailando".
    """
    if mode not in ("aist", "bailando"):
        raise ValueError(f"mode is aist or bailando, not {mode!r}")
    beats_of = partial(_aist_beats if mode == "aist" else _bailando_beats, fps=fps)
    pairs, counts, reason = _beats(points, onsets, beats_of)
    if not pairs:
        return Score.missing(reason, **counts)
    values = [
        beat_consistency(*(pair[::-1] if mode == "aist" else pair), sigma=ALIGN_SIGMA)
        for pair in pairs
    ]
    return Score(float(np.mean(values)), counts=counts)
