"""Hands, and arms with their sleeves, as shaded tapered capsules that each frame draws anew.

Pictures here are planar, (3, H, W) float32 in [0, 255], and change in place.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from data_prep.phantom.paint import Array, sample


@dataclass(frozen=True)
class Region:
    """A rectangle of the picture with the coordinates of its pixels."""

    rows: slice
    columns: slice
    x: Array  # (1, w)
    y: Array  # (h, 1)


def region(points: NDArray, margin: float, height: int, width: int) -> Region | None:
    """The part of the picture within `margin` pixels of the points (n, 2), None when outside."""
    low = np.floor(points.min(0) - margin).astype(int)
    high = np.ceil(points.max(0) + margin).astype(int) + 1
    x0, y0 = max(low[0], 0), max(low[1], 0)
    x1, y1 = min(high[0], width), min(high[1], height)
    if x1 <= x0 or y1 <= y0:
        return None
    x = np.arange(x0, x1, dtype=np.float32)[None, :]
    y = np.arange(y0, y1, dtype=np.float32)[:, None]
    return Region(slice(y0, y1), slice(x0, x1), x, y)


@dataclass(frozen=True)
class Capsule:
    """Where pixels lie on tapered capsules; every array has the shape (capsules, *pixels)."""

    distance: Array  # signed, pixels, negative inside
    along: Array  # 0 at the first end, 1 at the second, beyond in the caps
    nx: Array  # normal
    ny: Array
    across: Array  # signed share of the radius


def _column(values: NDArray, axes: int) -> Array:
    flat = np.asarray(values, np.float32)
    return flat.reshape(flat.shape + (1,) * axes)


def capsule(x: Array, y: Array, a: NDArray, b: NDArray, ra: NDArray, rb: NDArray) -> Capsule:
    """Capsules from a to b, (n, 2), with radii ra and rb, (n,), at pixels x, y of any shape."""
    axes = np.broadcast(x, y).ndim
    ax, ay = _column(a[:, 0], axes), _column(a[:, 1], axes)
    dx, dy = _column(b[:, 0] - a[:, 0], axes), _column(b[:, 1] - a[:, 1], axes)
    ra, slope = _column(ra, axes), _column(rb - ra, axes)
    square = np.maximum(dx * dx + dy * dy, np.float32(1e-3))
    px, py = x - ax, y - ay
    along = (px * dx + py * dy) / square
    held = np.minimum(np.maximum(along, 0), 1)
    ox, oy = px - held * dx, py - held * dy
    reach = np.sqrt(ox * ox + oy * oy)
    radius = ra + held * slope
    share = 1 / radius
    across = (py * dx - px * dy) * share / np.sqrt(square)
    return Capsule(reach - radius, along, ox * share, oy * share, across)  # type: ignore[arg-type]  # float64 by stubs


def shading(nx: Array, ny: Array, light: tuple[float, float, float], ambient: float) -> Array:
    """Light on a rounded surface with normals (nx, ny), about 1 where it faces the viewer."""
    flat = nx * nx + ny * ny
    nz = np.sqrt(np.maximum(1 - flat, np.float32(0.02)))
    shrink = 1 / np.sqrt(np.maximum(flat, 1))
    gain = np.float32((1 - ambient) / light[2])
    facing = (nx * np.float32(light[0]) + ny * np.float32(light[1])) * shrink
    return np.float32(ambient) + gain * np.maximum(facing + nz * np.float32(light[2]), 0)


_ROW = 32_000
"""Longest row that cv2 takes."""

_WARM = (0.18, 0.0, -0.1)
"""How much redder skin is in half shadow, by channel."""


def skin_colour(skin: tuple[float, float, float], tone: Array) -> Array:
    """Skin (3, *shape) under the light `tone`; shadows are redder."""
    half = tone * (1 - tone)
    return np.stack(
        [np.float32(c) * (tone + np.float32(w) * half) for c, w in zip(skin, _WARM, strict=True)]
    )


def shadow(
    picture: Array, points: NDArray, radius: float, offset: tuple[float, float], depth: float
) -> None:
    """Soft shadow of a limb along the points (n, 2) on what lies behind it."""
    moved = points + np.asarray(offset, np.float32)
    where = region(moved, radius * 2.2, *picture.shape[1:])
    if where is None:
        return
    corner = np.array([where.columns.start, where.rows.start], np.float32)
    rows, columns = len(where.y), where.x.shape[1]
    small = np.zeros((rows // 4 + 1, columns // 4 + 1), np.float32)
    fixed = np.round((moved - corner) / 4 * 16).astype(np.int32)
    cv2.polylines(small, [fixed], False, (depth,), max(1, round(radius / 2)), cv2.LINE_AA, 4)
    small = cv2.GaussianBlur(small, (0, 0), radius * 0.09)
    full = cv2.resize(1 - small, (4 * small.shape[1], 4 * small.shape[0]))
    picture[:, where.rows, where.columns] *= full[:rows, :columns]


@dataclass(frozen=True)
class Pixels:
    """The pixels that a set of capsules can touch."""

    x: Array  # (n,)
    y: Array
    flat: NDArray[np.intp]  # (n,) indices into a plane of the picture

    def lay(self, picture: Array, colour: Array, mask: Array) -> None:
        """Lay colours (3, n) over the picture (3, H, W) where `mask` (n,) says."""
        plane = picture.reshape(3, -1)
        below = plane[:, self.flat]
        plane[:, self.flat] = below + (colour - below) * mask


def touched(picture: Array, a: NDArray, b: NDArray, radii: NDArray) -> Pixels | None:
    """Pixels within the capsules from a to b, (n, 2), of radii (n, 2), and two pixels around."""
    where = region(np.concatenate([a, b]), float(radii.max()) + 2, *picture.shape[1:])
    if where is None:
        return None
    corner = np.array([where.columns.start, where.rows.start], np.float32)
    mask = np.zeros((len(where.y), where.x.shape[1]), np.uint8)
    lines = np.round((np.stack([a, b], 1) - corner) * 16).astype(np.int32)
    for line, radius in zip(lines, radii.max(1), strict=True):
        start, end = (int(line[0, 0]), int(line[0, 1])), (int(line[1, 0]), int(line[1, 1]))
        cv2.line(mask, start, end, (1,), int(2 * radius) + 5, cv2.LINE_8, 4)
    rows, columns = np.nonzero(mask)
    flat = (rows + where.rows.start) * picture.shape[2] + columns + where.columns.start
    return Pixels(where.x[0, columns], where.y[rows, 0], flat)


@dataclass(frozen=True)
class Sleeve:
    """Cloth and skin of an arm."""

    tile: Array  # (TILE, TILE, 3) in [0, 255]
    density: float  # tile pixels a unit
    reach: float  # where the sleeve ends: 0 shoulder, 1 elbow, 2 wrist
    skin: tuple[float, float, float]
    loose: float  # radius of the sleeve over that of the arm
    scale: int = 1  # of the picture, see `figure.Figure`


def _rows(values: Array) -> Array:
    """Values (n,) as (1, n), or in rows of `_ROW`, zeros at the end; cv2 takes no longer row."""
    if len(values) <= _ROW:
        return values[None]
    return np.pad(values, (0, -len(values) % _ROW)).reshape(-1, _ROW)


def _arm_colour(
    parts: Capsule, lower: Array, lengths: NDArray, girth: float, sleeve: Sleeve,
    light: tuple[float, float, float],
) -> Array:  # fmt: skip
    """Colours (3, n) of n pixels of an arm; `lower` (n,) is the share of the forearm in each."""
    tone2 = shading(parts.nx, parts.ny, light, 0.42)
    tone = tone2[0] + (tone2[1] - tone2[0]) * lower
    front = lower > 0.5
    across = np.where(front, parts.across[1], parts.across[0])
    along = np.where(front, parts.along[1], parts.along[0])
    place = along + front
    run = np.where(front, lengths[0] + along * lengths[1], along * lengths[0])
    contact = np.maximum(parts.distance[1] / sleeve.scale, 0) + 60 * np.maximum(
        0, parts.along[0] - 0.8
    )
    tone = tone * (1 - np.float32(0.22) * np.exp(contact * np.float32(-0.16)) * (1 - lower))
    around = np.arcsin(np.minimum(np.maximum(across, -1), 1)) * np.float32(girth * 1.1)
    wool = sample(
        sleeve.tile, _rows(around * sleeve.density + 40), _rows(run * sleeve.density)
    ).reshape(-1, 3)[: len(run)]
    dressed = np.minimum(np.maximum((sleeve.reach - place) * 30 + 0.5, 0), 1).astype(np.float32)
    bare = skin_colour(sleeve.skin, tone)
    colour = bare + (wool.T * tone - bare) * dressed
    return colour * (1 - np.float32(0.35) * np.exp(-(((place - sleeve.reach) / 0.03) ** 2)))


def arm(
    picture: Array, joints: NDArray, lengths: NDArray, radii: NDArray, sleeve: Sleeve,
    light: tuple[float, float, float],
) -> None:  # fmt: skip
    """Draw upper arm and forearm; the forearm lies before the upper arm.

    Args:
        picture: (3, H, W), changed in place.
        joints: shoulder, elbow and wrist, (3, 2) pixels.
        lengths: of upper arm and forearm in units, (2,), for the texture.
        radii: at shoulder, elbow and wrist, (3,) pixels.
        sleeve: what covers the arm.
        light: direction towards the light.
    """
    worn = radii * np.where(np.arange(3) < sleeve.reach + 0.2, sleeve.loose, 1.0)
    worn = worn.astype(np.float32)
    pixels = touched(picture, joints[:2], joints[1:], np.stack([worn[:2], worn[1:]], 1))
    if pixels is None:
        return
    parts = capsule(pixels.x, pixels.y, joints[:2], joints[1:], worn[:2], worn[1:])
    soft = np.float32(0.7) + 7 * np.maximum(0, 1 - np.abs(parts.along[1]) * 3)
    lower = np.minimum(np.maximum(0.5 - parts.distance[1] / soft, 0), 1)
    lower = np.where(parts.distance[0] > 0, 1, lower) * (parts.distance[1] < 0.6)
    colour = _arm_colour(parts, lower, lengths, float(worn.mean()) / sleeve.scale, sleeve, light)
    edge = np.minimum(np.maximum(0.5 - parts.distance.min(0), 0), 1)
    seam = (parts.along[0] * lengths[0] + 15) / 14
    edge = edge * np.maximum(lower, np.minimum(np.maximum(seam, 0), 1))
    pixels.lay(picture, colour, edge)


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
    shape: NDArray  # (6,) curls and spread, a blend of `gesture.SHAPES`
    turn: float  # 1 thumb on the clockwise side, -1 on the other, 0 edge on
    fore: float  # length as seen, 1 in the plane of the picture


def draw_hand(
    picture: Array, hand: Hand, skin: tuple[float, float, float], light: tuple[float, float, float]
) -> None:
    """Draw a hand: palm first, then the fingers from the little one to the thumb."""
    starts, ends, radii = _bones(hand.shape, hand.turn, hand.fore)
    cos, sin = hand.scale * np.cos(hand.angle), hand.scale * np.sin(hand.angle)
    spin = np.array([[cos, sin], [-sin, cos]], np.float32)
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
