"""How well motion keeps time: starts of strokes, beat consistency, percentage of matched beats.

The two scores compare beats of the motion (moments at which the hands come to rest or turn) with
onsets of the sound. Motion is that of joints in any unit; here they are hands and wrists of the
phantom, which play the role of the active regions or of the arms.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from data_prep.phantom.skeleton import JOINTS
from data_prep.rates import FPS

ACTIVE = ("right_wrist", "right_hand", "left_wrist", "left_hand")
"""Joints whose motion is scored."""

PROMINENCE = 0.03
"""By how much a neighbour of a motion beat must exceed it, in units of the mean activity."""

SIGMA = 0.1
"""Seconds at which beat consistency counts exp(-1/2)."""

NEAR = 0.2
"""Seconds within which two beats match."""

SPACING = 0.2
"""Seconds below which an onset does not count after another (Rhythmic Gesticulator, D_m)."""

LEVEL = 0.05
"""Share of a movement's largest speed at which it counts as begun."""

_SMOOTH = 0.05 * FPS


def steps(joints: NDArray) -> NDArray:
    """Distances (T, 4) that the active joints go in the frame before each, first row zero.

    Args:
        joints: (T, J, 2) as `skeleton.JOINTS`, any unit.
    """
    active = joints[:, [JOINTS.index(name) for name in ACTIVE]].astype(np.float64)
    moved = np.linalg.norm(np.diff(active, axis=0), axis=-1)
    return np.concatenate([np.zeros((1, len(ACTIVE))), moved])


def arm_turns(joints: NDArray) -> NDArray:
    """Changes (T, 4) of the angles at shoulders and elbows in each frame, radians."""
    at = {name: joints[:, index].astype(np.float64) for index, name in enumerate(JOINTS)}
    angles = []
    for side in ("right", "left"):
        chain = ["neck", f"{side}_shoulder", f"{side}_elbow", f"{side}_wrist"]
        bones = [at[b] - at[a] for a, b in zip(chain[:-1], chain[1:], strict=True)]
        for first, second in zip(bones[:-1], bones[1:], strict=True):
            lengths = np.linalg.norm(first, axis=-1) * np.linalg.norm(second, axis=-1)
            cosine = (first * second).sum(-1) / np.maximum(lengths, 1e-9)
            angles.append(np.arccos(np.clip(cosine, -1, 1)))
    turned = np.abs(np.diff(np.stack(angles, 1), axis=0))
    return np.concatenate([np.zeros((1, 4)), turned])


def activity(changes: NDArray, usual: NDArray) -> NDArray:
    """Curve (T,) of mean 1 over the data: changes (T, n) over their usual size (n,), averaged."""
    return (changes / usual).mean(1)


def minima(curve: NDArray, prominence: float = PROMINENCE) -> NDArray:
    """Times (m,) in seconds of the local minima of a curve (T,) at `FPS`.

    A minimum lies below both neighbours, and below one of them by `prominence` or more; the
    first two and the last frame have none (HA2G, released code).
    """
    middle, before, after = curve[2:-1], curve[1:-2], curve[3:]
    lowest = (middle < before) & (middle < after)
    deep = np.maximum(before, after) - middle >= prominence
    return (np.flatnonzero(lowest & deep) + 2) / FPS


def beat_consistency(motion: NDArray, sound: NDArray) -> float:
    """Mean over the onsets of a sound of exp(-d^2 / (2 SIGMA^2)), d to the nearest motion beat.

    HA2G (Liu et al. 2022), released code.

    Args:
        motion: beats (m,) in seconds, m above 0.
        sound: onsets (n,) in seconds, n above 0.
    """
    away = np.abs(sound[:, None] - motion).min(1)
    return float(np.exp(-(away**2) / (2 * SIGMA**2)).mean())


def smooth_minima(curve: NDArray) -> NDArray:
    """Motion beats (m,) of the percentage of matched beats: ends of deceleration, seconds."""
    smooth = gaussian_filter1d(curve, _SMOOTH)
    return minima(smooth, PROMINENCE * float(curve.mean()))


def spaced(sound: NDArray) -> NDArray:
    """Onsets without those that follow another that counts by less than `SPACING`."""
    kept: list[float] = []
    for onset in sound:
        if not kept or onset - kept[-1] >= SPACING - 1e-6:
            kept.append(float(onset))
    return np.array(kept)


def matched_beats(motion: NDArray, sound: NDArray) -> float:
    """Percentage of motion beats less than `NEAR` seconds from an onset of their own.

    In order, each onset counts once (Rhythmic Gesticulator, Ao et al. 2022, after Ho et al. 2013).

    Args:
        motion: beats (m,) in seconds, in order, m above 0.
        sound: onsets (n,) in seconds, in order, as `spaced` leaves them.
    """
    matched, free = 0, 0
    for beat in motion:
        near = np.flatnonzero(np.abs(sound[free:] - beat) < NEAR)
        if len(near):
            matched += 1
            free += int(near[0]) + 1
    return 100 * matched / len(motion)


def stroke_start(joints: NDArray, hand: str, onset: float, prepared: float) -> float:
    """When a hand sets off towards a stroke, seconds; infinite when it does not.

    The speed of the wrist along the way from its place at `onset` to that at `prepared` rises
    through `LEVEL` of its largest there; of several such moments, the one nearest to `onset`.

    Args:
        joints: (T, J, 2) as `skeleton.JOINTS`, any unit.
        hand: "right", "left" or "both", as the truth has it.
        onset: stated start of the stroke, seconds.
        prepared: stated end of its preparation, seconds.
    """
    path = joints[:, JOINTS.index("left_wrist" if hand == "left" else "right_wrist")]
    path = path.astype(np.float64)
    first, last = max(round((onset - 0.2) * FPS), 0), min(round(prepared * FPS), len(path) - 1)
    way = path[last] - path[min(round(onset * FPS), last - 1)]
    speed = np.diff(path[first : last + 1], axis=0) @ (way / max(np.linalg.norm(way), 1e-6))
    level = LEVEL * speed.max()
    rises = np.flatnonzero((speed[:-1] < level) & (speed[1:] >= level))
    if not len(rises):
        return np.inf
    share = (level - speed[rises]) / (speed[rises + 1] - speed[rises])
    times = (first + 0.5 + rises + share) / FPS
    return float(times[np.argmin(np.abs(times - onset))])
