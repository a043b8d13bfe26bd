"""Arms and hands, drawn anew in every frame as shaded tapered capsules with cloth or skin."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from data_prep.phantom.paint import Array
from data_prep.phantom.texture import sample

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


@dataclass(frozen=True)
class Region:
    """A rectangle of the frame with its pixel grid."""

    rows: slice
    columns: slice
    x: Array
    y: Array


def region(points: NDArray, margin: float, height: int, width: int) -> Region | None:
    """The part of the frame within `margin` pixels of the points (n, 2), None when outside."""
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
    """Where each pixel lies on a capsule: arrays (..., H, W)."""

    distance: Array  # signed, pixels, negative inside
    along: Array  # 0 at the first end, 1 at the second
    nx: Array  # normal
    ny: Array
    across: Array  # signed share of the radius


def capsule(x: Array, y: Array, a: NDArray, b: NDArray, ra: NDArray, rb: NDArray) -> Capsule:
    """Tapered capsules from a to b, (..., 2), with radii ra and rb, (...,)."""
    a, b = (
        np.asarray(a, np.float32)[..., None, None, :],
        np.asarray(b, np.float32)[..., None, None, :],
    )
    ra = np.asarray(ra, np.float32)[..., None, None]
    rb = np.asarray(rb, np.float32)[..., None, None]
    dx, dy = b[..., 0] - a[..., 0], b[..., 1] - a[..., 1]
    square = np.maximum(dx * dx + dy * dy, 1e-3)
    px, py = x - a[..., 0], y - a[..., 1]
    along = np.clip((px * dx + py * dy) / square, 0, 1)
    ox, oy = px - along * dx, py - along * dy
    reach = np.sqrt(ox * ox + oy * oy)
    radius = ra + along * (rb - ra)
    across = (oy * dx - ox * dy) / (np.sqrt(square) * radius)
    return Capsule(reach - radius, along, ox / radius, oy / radius, across)


def shading(nx: Array, ny: Array, light: tuple[float, float, float], ambient: float) -> Array:
    """Light on a rounded surface with normals (nx, ny), about 1 facing the viewer."""
    nz = np.sqrt(np.maximum(1 - nx * nx - ny * ny, 0.02))
    facing = np.maximum(nx * light[0] + ny * light[1] + nz * light[2], 0)
    return ambient + (1 - ambient) * facing / light[2]


def blend(frame: Array, where: Region, colour: Array, mask: Array) -> None:
    """Lay `colour` (h, w, 3) over the region of the frame where `mask` (h, w) says."""
    view = frame[where.rows, where.columns]
    view += (colour - view) * mask[..., None]


def shadow(
    frame: Array, points: NDArray, radius: float, offset: tuple[float, float], depth: float
) -> None:
    """Soft shadow of a limb along the points (n, 2) on what lies behind it."""
    moved = points + np.asarray(offset, np.float32)
    height, width = frame.shape[:2]
    where = region(moved, radius * 2.6, height, width)
    if where is None:
        return
    corner = np.array([where.columns.start, where.rows.start], np.float32)
    rows, columns = len(where.y), where.x.shape[1]
    small = np.zeros((rows // 2 + 1, columns // 2 + 1), np.float32)
    fixed = np.round((moved - corner) / 2 * 16).astype(np.int32)
    cv2.polylines(small, [fixed], False, (depth,), max(1, round(radius)), cv2.LINE_AA, 4)
    small = cv2.GaussianBlur(small, (0, 0), radius * 0.32)
    mask = cv2.resize(small, (columns, rows))
    frame[where.rows, where.columns] *= (1 - mask)[..., None]


@dataclass(frozen=True)
class Sleeve:
    """Cloth and skin of an arm."""

    tile: Array
    density: float  # tile pixels a unit
    reach: float  # where the sleeve ends: 0 shoulder, 1 elbow, 2 wrist
    skin: tuple[float, float, float]
    loose: float  # sleeve radius over arm radius


def arm(
    frame: Array,
    joints: NDArray,
    lengths: tuple[float, float],
    radii: tuple[float, float, float],
    sleeve: Sleeve,
    light: tuple[float, float, float],
) -> None:
    """Draw upper arm and forearm.

    Args:
        frame: (H, W, 3) float32, changed in place.
        joints: shoulder, elbow and wrist, (3, 2) pixels.
        lengths: of upper arm and forearm in units, for the texture.
        radii: at shoulder, elbow and wrist, pixels.
        sleeve: what covers the arm.
        light: direction towards the light.
    """
    where = region(joints, max(radii) * sleeve.loose + 3, *frame.shape[:2])
    if where is None:
        return
    r = np.asarray(radii, np.float32)
    both = capsule(where.x, where.y, joints[:2], joints[1:], r[:2], r[1:])
    place = np.stack([both.along[0], 1 + both.along[1]])
    edge = np.clip((sleeve.reach - place) * 26, 0, 1)
    swell = (sleeve.loose - 1) * r.mean() * edge
    distance = both.distance - swell
    mix = np.clip(0.5 + 0.5 * (distance[0] - distance[1]) / 7.0, 0, 1)
    joined = distance[0] + (distance[1] - distance[0]) * mix - 7.0 * mix * (1 - mix)
    pick = lambda pair: pair[0] + (pair[1] - pair[0]) * mix  # noqa: E731
    nx, ny, across = pick(both.nx), pick(both.ny), pick(both.across)
    limit = np.maximum(np.hypot(nx, ny), 1.0)
    tone = shading(nx / limit, ny / limit, light, 0.42)
    bend = np.exp(-(((place[0] - 1) / 0.22) ** 2)) * np.clip(across, -1, 1)
    tone = tone * (1 - 0.10 * np.abs(bend)) * (1 - 0.16 * np.exp(-(((pick(place)) / 0.12) ** 2)))
    u = np.arcsin(np.clip(across, -1, 1)) * r.mean() * sleeve.density * 1.1
    run = np.where(mix < 0.5, both.along[0] * lengths[0], lengths[0] + both.along[1] * lengths[1])
    wool = sample(sleeve.tile, u + 40, run * sleeve.density)
    dressed = np.clip((sleeve.reach - pick(place)) * 30 + 0.5, 0, 1)
    cuff = 1 - 0.35 * np.exp(-(((pick(place) - sleeve.reach) / 0.03) ** 2))
    bare = np.asarray(sleeve.skin, np.float32) * tone[..., None] ** np.array([0.8, 1, 1.12])
    colour = bare + (wool * tone[..., None] - bare) * dressed[..., None]
    blend(frame, where, (colour * cuff[..., None]).astype(np.float32), np.clip(0.5 - joined, 0, 1))


def _fingers(curl: NDArray, spread: float, turn: float) -> tuple[Array, Array, Array]:
    """Points (15, 2) of three joints a finger in the hand's frame, heights and radii (5,)."""
    side = np.where(turn >= 0, 1.0, -1.0) * (0.42 + 0.58 * abs(turn))
    base = _BASE * np.array([1.0, side], np.float32)
    splay = _SPLAY * (0.35 + spread)
    splay[0] = 0.95 - 0.55 * curl[0]
    splay = splay * side
    first, second = curl * 1.35, curl * 1.35 + curl * 1.75
    span = np.stack([0.55 * np.cos(first), 0.45 * np.cos(second)], 1) * _LENGTH[:, None]
    direction = np.stack([np.cos(splay), np.sin(splay)], 1)
    middle = base + direction * span[:, :1]
    tip = middle + direction * span[:, 1:]
    return np.concatenate([base, middle, tip], 1).reshape(5, 3, 2).astype(np.float32), first, side


def hand(
    frame: Array,
    wrist: NDArray,
    angle: float,
    scale: float,
    shape: NDArray,
    turn: float,
    fore: float,
    skin: tuple[float, float, float],
    light: tuple[float, float, float],
) -> None:
    """Draw a hand.

    Args:
        frame: (H, W, 3) float32, changed in place.
        wrist: (2,) pixels.
        angle: direction of the fingers, radians from x towards y.
        scale: pixels a unit.
        shape: (6,) curls and spread, a blend of `SHAPES`.
        turn: 1 thumb on the clockwise side, -1 on the other, 0 edge on.
        fore: length of the hand as seen, 1 in the picture's plane.
        skin: colour.
        light: direction towards the light.
    """
    points, _, side = _fingers(shape[:5], float(shape[5]), turn)
    knuckle = np.array([[(6, 4 * side), (27, 8 * side)], [(6, -4 * side), (27, -6.5 * side)]])
    fan = points[:, :, :] * np.array([fore, 1.0], np.float32)
    palm = knuckle * np.array([fore, 1.0])
    cos, sin = np.cos(angle), np.sin(angle)
    spin = np.array([[cos, sin], [-sin, cos]], np.float32) * scale
    fan, palm = fan @ spin + wrist, palm @ spin + wrist
    where = region(
        np.concatenate([fan.reshape(-1, 2), palm.reshape(-1, 2), wrist[None]]),
        10 * scale,
        *frame.shape[:2],
    )
    if where is None:
        return
    order = [4, 3, 2, 1, 0] if turn >= 0 else [4, 3, 2, 1, 0]
    root = wrist + (np.array([0.0, 0.0]) @ spin)
    starts = [root, palm[0, 0], palm[1, 0]]
    ends = [(palm[0, 1] + palm[1, 1]) / 2, palm[0, 1], palm[1, 1]]
    radii = [(8.6, 9.0), (8.5, 6.6), (8.5, 6.4)]
    for finger in order:
        starts += [fan[finger, 0], fan[finger, 1]]
        ends += [fan[finger, 1], fan[finger, 2]]
        r = _RADIUS[finger]
        radii += [(r * (1.25 if finger == 0 else 1.04), r), (r, r * 0.84)]
    sizes = np.asarray(radii, np.float32) * scale
    pieces = capsule(where.x, where.y, np.stack(starts), np.stack(ends), sizes[:, 0], sizes[:, 1])
    limit = np.maximum(np.hypot(pieces.nx, pieces.ny), 1.0)
    tone = shading(pieces.nx / limit, pieces.ny / limit, light, 0.5)
    masks = np.clip(0.5 - pieces.distance, 0, 1)
    palm_distance = pieces.distance[:3].min(0)
    palm_tone = tone[0] + 0.0 * palm_distance
    inner = np.clip(-palm_distance / (7 * scale), 0, 1)
    palm_tone = 0.70 + 0.30 * inner + 0.25 * (tone[:3].max(0) - 1) * (1 - inner)
    canvas_tone = palm_tone
    cover = np.clip(0.5 - palm_distance, 0, 1)
    for index in range(3, len(masks), 2):
        pair = np.maximum(masks[index], masks[index + 1])
        finger_tone = np.where(
            pieces.distance[index + 1] < pieces.distance[index], tone[index + 1], tone[index]
        )
        halo = np.clip(
            1 - np.minimum(pieces.distance[index], pieces.distance[index + 1]) / (2.2 * scale), 0, 1
        )
        canvas_tone = canvas_tone * (1 - 0.20 * halo)
        canvas_tone = canvas_tone + (finger_tone * 0.99 - canvas_tone) * pair
        cover = np.maximum(cover, pair)
    colour = np.asarray(skin, np.float32) * np.maximum(canvas_tone, 0.1)[..., None] ** np.array(
        [0.8, 1, 1.12]
    )
    blend(frame, where, colour.astype(np.float32), cover)
