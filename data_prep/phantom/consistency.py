"""Motion of the phantom's joints as `data_prep.synchrony` scores it, and starts of strokes.

Hands and wrists play the role of the active regions, or of the arms.
"""

import numpy as np
from numpy.typing import NDArray

from data_prep import synchrony
from data_prep.phantom.skeleton import JOINTS
from data_prep.rates import FPS

ACTIVE = ("right_wrist", "right_hand", "left_wrist", "left_hand")
"""Joints whose motion is scored."""

LEVEL = 0.05
"""Share of a movement's largest speed at which it counts as begun."""


def steps(joints: NDArray) -> NDArray:
    """Distances (T, 4) that the active joints go in the frame before each, first row zero.

    Args:
        joints: (T, J, 2) as `skeleton.JOINTS`, any unit.
    """
    return synchrony.steps(joints[:, [JOINTS.index(name) for name in ACTIVE]])


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
