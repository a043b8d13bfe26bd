"""Hands: shapes of the fingers, and how a hand is drawn from capsules."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_prep.phantom.limbs import capsule, shading, skin_colour, touched
from data_prep.phantom.paint import Array

FINGERS = ("thumb", "index", "middle", "ring", "little")
"""Order of the curls of a hand shape."""

SHAPES: dict[str, tuple[float, ...]] = {
    "relaxed": (0.35, 0.28, 0.34, 0.40, 0.46, 0.35),
    "open": (0.05, 0.02, 0.00, 0.02, 0.05, 1.15),
    "flat": (0.25, 0.03, 0.03, 0.03, 0.05, 0.15),
    "fist": (0.75, 0.95, 0.95, 0.95, 0.95, 0.10),
    "point": (0.70, 0.02, 0.92, 0.95, 0.95, 0.20),
    "pinch": (0.55, 0.52, 0.30, 0.26, 0.24, 0.55),
    "two": (0.75, 0.02, 0.02, 0.95, 0.95, 0.80),
    "three": (0.10, 0.02, 0.02, 0.95, 0.95, 0.95),
    "cup": (0.30, 0.36, 0.36, 0.36, 0.36, 0.60),
}
"""Curl of each finger, 0 straight to 1 folded, and the spread between fingers."""

_BASE = np.array([(9, 11), (28, 9.5), (29.5, 3.4), (28.5, -3.0), (26, -9.0)], np.float32)
_LENGTH = np.array([25, 28, 31, 28, 22], np.float32)
_RADIUS = np.array([5.4, 4.7, 4.8, 4.5, 4.0], np.float32)
_SPLAY = np.array([0.0, 0.17, 0.03, -0.11, -0.27], np.float32)


def _fingers(curl: NDArray, spread: float, side: float) -> Array:
    """Joints (5, 3, 2) of the fingers in the hand's frame: along the hand, across it."""
    base = _BASE * np.array([1.0, side], np.float32)
    splay = _SPLAY * (0.35 + spread)
    splay[0] = 0.95 - 0.55 * curl[0]
    splay = splay * side
    first, second = curl * 1.35, curl * 3.1
    span = np.stack([0.55 * np.cos(first), 0.45 * np.cos(second)], 1) * _LENGTH[:, None]
    direction = np.stack([np.cos(splay), np.sin(splay)], 1)
    middle = base + direction * span[:, :1]
    tip = middle + direction * span[:, 1:]
    return np.stack([base, middle, tip], 1).astype(np.float32)


def _bones(shape: NDArray, turn: float, fore: float) -> tuple[Array, Array, Array]:
    """Starts (13, 2), ends (13, 2) and radii (13, 2): three of the palm, two a finger."""
    side = float(np.sign(turn)) * abs(turn) ** 0.6
    fingers = _fingers(shape[:5], float(shape[5]), side)[::-1]
    starts = np.array([(0, 0), (7, 4 * side), (7, -4 * side)], np.float32)
    ends = np.array([(28, 0.6 * side), (27, 8 * side), (27, -6.5 * side)], np.float32)
    starts = np.concatenate([starts, fingers[:, :2].reshape(-1, 2)])
    ends = np.concatenate([ends, fingers[:, 1:].reshape(-1, 2)])
    r = _RADIUS[::-1]
    swell = np.array([1.04, 1.04, 1.04, 1.04, 1.25], np.float32)
    digits = np.stack([np.stack([r * swell, r], 1), np.stack([r, r * 0.84], 1)], 1).reshape(-1, 2)
    palm = np.array([(8.4, 9.0), (8.5, 6.6), (8.5, 6.4)], np.float32)
    squeeze = np.array([fore, 1.0], np.float32)
    return starts * squeeze, ends * squeeze, np.concatenate([palm, digits])


@dataclass(frozen=True)
class Hand:
    """A hand in one picture."""

    wrist: NDArray  # (2,) pixels
    angle: float  # direction of the fingers, radians from x towards y
    scale: float  # pixels a unit
    shape: NDArray  # (6,) curls and spread, a blend of `SHAPES`
    turn: float  # 1 thumb on the clockwise side, -1 on the other, 0 edge on
    fore: float  # length as seen, 1 in the plane of the picture


def draw_hand(
    picture: Array,
    hand: Hand,
    skin: tuple[float, float, float],
    light: tuple[float, float, float],
) -> None:
    """Draw a hand: palm first, then the fingers from the little one to the thumb."""
    starts, ends, radii = _bones(hand.shape, hand.turn, hand.fore)
    cos, sin = np.cos(hand.angle), np.sin(hand.angle)
    spin = (np.array([[cos, sin], [-sin, cos]]) * hand.scale).astype(np.float32)
    starts, ends = starts @ spin + hand.wrist, ends @ spin + hand.wrist
    radii = radii * np.float32(hand.scale)
    pixels = touched(picture, starts, ends, radii)
    if pixels is None:
        return
    parts = capsule(pixels.x, pixels.y, starts, ends, radii[:, 0], radii[:, 1])
    palm = parts.distance[:3].min(0)
    near = palm.copy()
    inner = np.minimum(np.maximum(palm * np.float32(-1 / (7 * hand.scale)), 0), 1)
    light_palm = shading(parts.nx[:1], parts.ny[:1], light, 0.5)[0]
    tone = np.float32(0.66) + np.float32(0.32) * inner + np.float32(0.3) * (light_palm - 1)
    for index in range(3, len(starts), 2):
        root, tip = parts.distance[index], parts.distance[index + 1]
        distance = np.minimum(root, tip)
        first = root < tip
        nx = np.where(first, parts.nx[index], parts.nx[index + 1])
        ny = np.where(first, parts.ny[index], parts.ny[index + 1])
        halo = np.maximum(1 - np.maximum(distance, 0) * np.float32(0.45 / hand.scale), 0)
        tone = tone * (1 - np.float32(0.22) * halo)
        inside = np.minimum(np.maximum(0.5 - distance, 0), 1)
        tone = tone + (shading(nx, ny, light, 0.5) - tone) * inside
        near = np.minimum(near, distance)
    cover = np.minimum(np.maximum(0.5 - near, 0), 1)
    pixels.lay(picture, skin_colour(skin, tone), cover)
