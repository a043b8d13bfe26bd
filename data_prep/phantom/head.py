"""The head: a sculpted, shaded face with eyes that blink, a mouth that opens, and hair.

The origin is the middle of the head, the crown at y = -50 and the chin at y = 50; the eyes lie on
y = 0. Expressions are drawn once each and kept, so that a frame only pastes two patches.
"""

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from data_prep.phantom.paint import (
    Array,
    Canvas,
    blur,
    bump,
    cover,
    inflate,
    lambert,
    mirrored,
    noise,
    smooth,
)
from data_prep.phantom.presenters import Look, Setting

HEAD = Canvas(-70, -84, 70, 116, 2.0)
"""Raster of the head, in units about its middle."""

_EYES = Canvas(-31, -23, 31, 11, 2.0)
_MOUTH = Canvas(-21, 23, 21, 48, 2.0)
_LEVELS = 6


_OUTER: dict[str, list[tuple[float, float]]] = {
    "short": [(0, -60), (16, -58), (30, -50), (39, -36), (41.5, -18), (39.5, -2)],
    "crop": [(0, -54.5), (15, -53), (28, -45), (36, -31), (38.8, -14), (37.5, -3)],
    "bun": [(0, -56), (15, -54), (28, -46.5), (37, -32), (39.5, -15), (38, -2)],
    "bob": [(0, -61), (17, -58.5), (33, -50), (44, -34), (48, -10), (48, 18), (43, 38), (36, 44)],
    "long": [
        (0, -61),
        (17, -58.5),
        (33, -50),
        (43, -34),
        (46, -10),
        (46, 20),
        (48, 60),
        (47, 86),
        (39, 99),
    ],
}
_INNER: dict[str, list[tuple[float, float]]] = {
    "short": [(36.5, 2), (34.5, -12), (31, -26), (18, -34), (4, -32)],
    "crop": [(35.8, -2), (33.5, -20), (27, -31), (12, -35), (0, -35.5)],
    "bun": [(35.8, -2), (33.5, -18), (27, -31), (12, -36), (0, -37)],
    "bob": [(31, 41), (33.5, 20), (33.5, -8), (27, -24), (12, -31)],
    "long": [(33, 90), (35, 50), (35, 8), (31.5, -14), (20, -28), (5, -34)],
}
"""Right half of the outline from the crown down, and back up along the hairline."""


def _strands(canvas: Canvas, rng: np.random.Generator, curly: bool) -> Array:
    """Streaks (H, W) of zero mean that run away from the crown."""
    if curly:
        return noise(rng, *canvas.shape, 0.75)
    x, y = canvas.grid()
    down = np.maximum(y - 0.0, 0)
    angle = np.arctan2(x, -(np.minimum(y, 0) - 34)) + 0 * down
    reach = np.hypot(x, np.minimum(y, 0) + 34) + down
    tile = cv2.resize(noise(rng, 32, 512, 0.55), (512, 256), interpolation=cv2.INTER_CUBIC)
    u = np.mod((angle + 4) * 90, 511).astype(np.float32)
    v = np.mod(reach * 1.6, 255).astype(np.float32)
    return cv2.remap(tile, u, v, cv2.INTER_LINEAR)  # type: ignore[return-value]


def _curls(canvas: Canvas, rng: np.random.Generator, front: bool) -> Array:
    """Coverage of a bushy head of curls; `front` leaves the face free."""
    x, y = canvas.grid()
    ring = np.linspace(0, 2 * np.pi, 46, endpoint=False)
    wobble = 1 + 0.05 * rng.standard_normal(46)
    outline = np.stack([54 * wobble * np.sin(ring), -16 - 52 * wobble * np.cos(ring)], 1)
    outline[:, 1] = np.minimum(outline[:, 1], 38)
    mask = canvas.fill(smooth([tuple(p) for p in outline], steps=4))
    if not front:
        return mask
    free = 1 / (1 + np.exp(-(1 - np.hypot(x / 33.5, (y - 14) / 43)) * 26))
    free = np.maximum(free, np.clip((y - 22) / 4, 0, 1))
    return (mask * (1 - free)).astype(np.float32)


def _mask(canvas: Canvas, look: Look, rng: np.random.Generator) -> Array:
    if look.hair_cut == "curly":
        return _curls(canvas, rng, front=True)
    outer, inner = _OUTER[look.hair_cut], _INNER[look.hair_cut]
    part = float(rng.uniform(-9, 9)) if look.hair_cut in ("bob", "short") else 0.0
    scale = look.face_width
    right = [(x * scale, y) for x, y in outer + inner]
    left = [(-x * scale, y) for x, y in reversed(outer[1:] + inner)]
    crest = [(part, -35.0 if look.hair_cut == "short" else -38.0)]
    return canvas.fill(smooth(right + crest + left, steps=8), 0.25)


def _paint(
    canvas: Canvas, look: Look, place: Setting, mask: Array, strands: Array, dim: float
) -> Array:
    sprite = np.zeros((*canvas.shape, 4), np.float32)
    x, y = canvas.grid()
    relief = inflate(mask, 22 * canvas.density, 3.0) + 1.1 * blur(strands, 1.0)
    light = lambert(relief, place.light, 0.42)
    sheen = bump(x, y, 26 * place.light[0], -42, 26, 7) + 0.5 * bump(x, y, 0, 20, 60, 16)
    streak = np.clip(0.6 + 0.5 * strands, 0, 2)
    tone = dim * light * (1 + 0.26 * strands)
    colour = np.asarray(look.hair, np.float32) * tone[..., None]
    colour += (0.16 * dim * sheen * streak)[..., None] * np.array([1, 0.92, 0.8], np.float32)
    cover(sprite, np.clip(colour, 0, 1), mask)
    return sprite


def front_hair(canvas: Canvas, look: Look, place: Setting, rng: np.random.Generator) -> Array:
    """Hair over the face: sprite (H, W, 4), empty for a bald head."""
    if look.hair_cut == "bald":
        return np.zeros((*canvas.shape, 4), np.float32)
    strands = _strands(canvas, rng, look.hair_cut == "curly")
    mask = _mask(canvas, look, rng)
    return _paint(canvas, look, place, mask, strands, 1.0)


def back_hair(canvas: Canvas, look: Look, place: Setting, rng: np.random.Generator) -> Array:
    """Hair behind neck and shoulders: sprite (H, W, 4), empty for short cuts."""
    outlines = {
        "bob": [(0, -55), (40, -40), (47, 0), (46, 36), (30, 48), (0, 48)],
        "long": [(0, -55), (36, -40), (45, 0), (46, 50), (43, 84), (20, 80), (0, 78)],
    }
    if look.hair_cut == "curly":
        mask = _curls(canvas, rng, front=False)
    elif look.hair_cut == "bun":
        ring = np.linspace(0, 2 * np.pi, 12, endpoint=False)
        mask = canvas.fill(smooth([(15 * np.sin(a), -58 - 13 * np.cos(a)) for a in ring]))
    elif look.hair_cut in outlines:
        mask = canvas.fill(smooth(mirrored([(x, y) for x, y in outlines[look.hair_cut]])))
    else:
        return np.zeros((*canvas.shape, 4), np.float32)
    strands = _strands(canvas, rng, look.hair_cut == "curly")
    return _paint(canvas, look, place, mask, strands, 0.62)


def tinted(skin: tuple[float, float, float], light: Array) -> Array:
    """Skin (H, W, 3) under `light` (H, W): shadows are redder, as light scatters in skin."""
    power = np.array([0.78, 1.0, 1.12], np.float32)
    return (np.asarray(skin, np.float32) * np.maximum(light, 0.02)[..., None] ** power).astype(
        np.float32
    )


def _outline(look: Look) -> Array:
    half = [(0, -50), (20, -47), (33, -34), (37, -14), (36.3, 6), (33.5, 22)]
    half += [(26.5 * look.jaw, 37), (14.5 * look.jaw, 47), (0, 50)]
    return smooth(mirrored([(x * look.face_width, y) for x, y in half]))


def _relief(look: Look, mask: Array) -> Array:
    """Height (H, W) of the face in pixels."""
    x, y = HEAD.grid()
    size = look.nose
    hills = 3.4 * bump(x, y, 0, 6, 3.3, 12) + size * 5.5 * bump(x, y, 0, 18, 4.6, 4.2)
    hills = hills + 3 * bump(x, y, 0, 33, 13, 8) + 3.2 * bump(x, y, 0, 45, 9, 5)
    for side in (-1, 1):
        hills = hills - 5.5 * bump(x, y, side * 16, -0.5, 8, 5)
        hills = hills + look.brow * 2.6 * bump(x, y, side * 15, -10, 11, 3.6)
        hills = hills + 3.2 * bump(x, y, side * 20, 16, 9, 8)
        hills = hills + size * 1.6 * bump(x, y, side * 6, 19.5, 2.6, 2.4)
    pillow = inflate(mask, 40 * HEAD.density, 4.0) * 0.9
    return (pillow + hills * HEAD.density * 0.8).astype(np.float32)


def _complexion(look: Look, rng: np.random.Generator) -> Array:
    """What multiplies the skin's brightness (H, W): sockets, creases, pores, shine."""
    x, y = HEAD.grid()
    tone = 1 + 0.02 * noise(rng, *HEAD.shape, 0.5) + 0.025 * noise(rng, *HEAD.shape, 1.5)
    tone = tone + 0.11 * bump(x, y, 0, 4, 3, 11) + 0.06 * bump(x, y, 0, -26, 18, 9)
    tone = tone - 0.34 * bump(x, y, 0, 23.2, 6.5, 1.7) - 0.12 * bump(x, y, 0, 40, 8, 2)
    for side in (-1, 1):
        tone = tone - 0.30 * bump(x, y, side * 16, -3.5, 9, 5)
        tone = tone - 0.10 * bump(x, y, side * 15, 6.5, 7, 1.6)
        tone = tone + 0.09 * bump(x, y, side * 20, 14, 9, 6)
        tone = tone - 0.30 * bump(x, y, side * 3.6, 21.6, 1.9, 1.0)
        tone = tone - 0.10 * bump(x, y, side * (15 + 0.1 * (y - 22)), 28, 1.8, 6)
    return tone.astype(np.float32)


def _beard(look: Look, rng: np.random.Generator) -> Array:
    x, y = HEAD.grid()
    low = 1 / (1 + np.exp(-(y - 22) / 3.0))
    low = low * np.clip((np.abs(x) / 22) ** 1.5 + (y > 27) * 0.9, 0, 1)
    lips = bump(x, y, 0, 33.5, 8.5, 3.4)
    grain = np.clip(0.8 + 0.25 * noise(rng, *HEAD.shape, 0.3), 0, 1.2)
    return (look.beard * np.clip(low - lips, 0, 1) * grain).astype(np.float32)


def _face(look: Look, place: Setting, rng: np.random.Generator) -> Array:
    sprite = np.zeros((*HEAD.shape, 4), np.float32)
    x, y = HEAD.grid()
    ring = np.linspace(0, 2 * np.pi, 10, endpoint=False)
    for side in (-1, 1):
        ear = [
            (side * (37.5 * look.face_width + 4.2 * np.sin(a)), 7 - 9.5 * np.cos(a)) for a in ring
        ]
        mask = HEAD.fill(smooth(ear), 0.3)
        light = 0.8 - 0.22 * bump(x, y, side * 38 * look.face_width, 7, 2, 5)
        cover(sprite, tinted(look.skin, light.astype(np.float32)), mask)
    mask = HEAD.fill(_outline(look), 0.3)
    light = lambert(_relief(look, mask), place.light, 0.5) * _complexion(look, rng)
    skin = tinted(look.skin, light)
    blush = np.zeros(HEAD.shape, np.float32)
    for side in (-1, 1):
        blush += bump(x, y, side * 21, 18, 8, 6)
    blush += 0.6 * bump(x, y, 0, 18, 5, 4)
    skin *= 1 - blush[..., None] * np.array([0.0, 0.09, 0.07], np.float32)
    stubble = np.asarray(look.hair, np.float32) * (0.75 * light[..., None])
    skin += (stubble - skin) * (0.75 * _beard(look, rng))[..., None]
    cover(sprite, np.clip(skin, 0, 1), mask)
    return sprite


def _brow(canvas: Canvas, patch: Array, look: Look, side: int, lift: float) -> None:
    y = -11.5 - 3.2 * lift
    arch = [(6.5, y + 0.6), (12, y - 0.8), (18, y - 1.8), (24.5, y + 1.4)]
    under = [(24.5, y + 2.2), (18, y + 0.9 * look.brow), (12, y + 2.2 * look.brow), (6.5, y + 2.9)]
    outline = smooth([(side * px, py) for px, py in arch + under], steps=6)
    mask = canvas.fill(outline, 0.55)
    cover(patch, np.asarray(look.hair, np.float32) * 0.55, np.minimum(0.85 * mask, patch[..., 3]))


def _eye(canvas: Canvas, patch: Array, look: Look, side: int, closed: float) -> None:
    x, y = canvas.grid()
    cx = side * 16.0
    top, low = 4.4 * (1 - closed) - 2.4 * closed, 2.7
    arc = np.linspace(-1, 1, 13)
    upper = [(cx + 7.6 * a, -top * (1 - a * a) + 0.6 * side * a) for a in arc]
    lower = [(cx + 7.6 * a, low * (1 - a * a) + 0.6 * side * a) for a in arc[::-1]]
    opening = canvas.fill(np.array(upper + lower), 0.2)
    shade = np.clip(0.62 + 0.07 * (y + top), 0.4, 0.92) + 0 * x
    white = shade[..., None] * np.array([1.0, 0.975, 0.95], np.float32)
    cover(patch, white, opening)
    radius = np.hypot(x - cx, y + 0.4)
    iris = np.clip((4.1 - radius) * 2, 0, 1) * opening
    ring = np.clip(0.55 + 0.16 * radius, 0, 1.1)[..., None] * np.asarray(look.eye, np.float32)
    cover(patch, ring, iris)
    cover(patch, (0.03, 0.03, 0.03), np.clip((2.0 - radius) * 2, 0, 1) * opening)
    glint = np.clip((1.1 - np.hypot(x - cx + 1.4, y + 1.9)) * 2, 0, 1) * opening
    cover(patch, (0.97, 0.97, 1.0), glint)
    lash = canvas.stroke(np.array(upper), 1.5, 0.25)
    cover(patch, (0.09, 0.06, 0.05), 0.85 * lash)
    cover(patch, np.asarray(look.skin) * 0.45, 0.35 * canvas.stroke(np.array(lower), 0.8, 0.3))
    crease = [(px, py - 2.6 + 1.2 * closed) for px, py in upper]
    cover(patch, np.asarray(look.skin) * 0.42, 0.55 * canvas.stroke(np.array(crease), 0.9, 0.5))


def _glasses(canvas: Canvas, patch: Array) -> None:
    frame = np.zeros(canvas.shape, np.float32)
    ring = np.linspace(0, 2 * np.pi, 40)
    for side in (-1, 1):
        box = np.stack(
            [
                side * 16 + 11.5 * np.sign(np.cos(ring)) * np.abs(np.cos(ring)) ** 0.7,
                0.6 + 8.2 * np.sign(np.sin(ring)) * np.abs(np.sin(ring)) ** 0.7,
            ],
            1,
        )
        frame = np.maximum(frame, canvas.stroke(box, 1.3, 0.2))
    frame = np.maximum(frame, canvas.stroke(np.array([(-4.6, -1), (0, -2.4), (4.6, -1)]), 1.3))
    for side in (-1, 1):
        arm = np.array([(side * 27.4, -1.5), (side * 36, -2.5)])
        frame = np.maximum(frame, canvas.stroke(arm, 1.3))
    cover(patch, (0.1, 0.09, 0.09), 0.85 * frame)


def _lips(canvas: Canvas, patch: Array, look: Look, gap: float, width: float) -> None:
    x, y = canvas.grid()
    half, top, drop = 12.0 * width, 33.0 - 0.8 * gap, 33.4 + 8.0 * gap
    arc = np.linspace(-1, 1, 15)
    round_ = 1 - arc * arc
    bow = 2.6 * round_**0.8 - 0.8 * np.exp(-((arc * 6) ** 2))
    corner = 31.7 + 1.2 * gap
    high = corner + (top - 0.2 - corner) * round_
    floor = corner + (drop - corner) * round_**0.8
    inside = canvas.fill(np.stack([np.r_[arc, arc[::-1]] * half, np.r_[high, floor[::-1]]], 1))
    cover(patch, (0.20, 0.07, 0.07), inside)
    tongue = bump(x, y, 0, drop, 6, 2.6) * inside
    cover(patch, (0.55, 0.24, 0.23), 0.8 * tongue)
    teeth = np.clip((top + 2.6 - y) * 2, 0, 1) * inside * np.clip((gap - 0.1) * 6, 0, 1)
    cover(patch, (0.86, 0.84, 0.80), teeth * np.clip((half * 0.72 - np.abs(x)) * 0.5, 0, 1))
    lip = np.asarray(look.lip, np.float32)
    upper = canvas.fill(
        np.stack([np.r_[arc, arc[::-1]] * half, np.r_[high - bow, (high + 0.4)[::-1]]], 1), 0.25
    )
    cover(patch, lip * 0.82, 0.9 * upper)
    full = 3.6 * round_**0.7
    low = canvas.fill(
        np.stack(
            [np.r_[arc, arc[::-1]] * half * 0.94, np.r_[floor - 0.4, (floor + full)[::-1]]], 1
        ),
        0.3,
    )
    shine = np.clip(1.0 + 0.22 * bump(x, y, -2, drop + 1.6, 5, 1.1), 0, 1.4)
    cover(patch, np.clip(lip * shine[..., None], 0, 1), 0.9 * low)
    line = canvas.stroke(np.stack([arc * half, high + 0.3], 1), 0.9, 0.25)
    cover(patch, (0.22, 0.09, 0.09), 0.7 * line * (1 - min(1.0, 2 * gap)))


def _crop(canvas: Canvas) -> tuple[slice, slice]:
    top = round((canvas.y0 - HEAD.y0) * HEAD.density)
    left = round((canvas.x0 - HEAD.x0) * HEAD.density)
    height, width = canvas.shape
    return slice(top, top + height), slice(left, left + width)


def _bytes(sprite: Array) -> NDArray[np.uint8]:
    return np.clip(sprite * 255 + 0.5, 0, 255).astype(np.uint8)


@dataclass
class Head:
    """Sprites of one presenter's head in one video.

    Args:
        look: the presenter's looks.
        place: light of the video.
        rng: source of randomness; nothing is drawn from it after construction.
    """

    look: Look
    place: Setting
    rng: np.random.Generator
    back: NDArray[np.uint8] = field(init=False)
    _base: Array = field(init=False)
    _whole: NDArray[np.uint8] = field(init=False)
    _patches: dict[tuple[str, int, int], NDArray[np.uint8]] = field(init=False)

    def __post_init__(self) -> None:
        self._base = _face(self.look, self.place, self.rng)
        hair = front_hair(HEAD, self.look, self.place, self.rng)
        fringe = blur(np.roll(hair[..., 3], 5, 0), 4) * self._base[..., 3]
        self._base[..., :3] *= (1 - 0.3 * fringe)[..., None]
        cover(self._base, hair[..., :3], hair[..., 3])
        self._whole = _bytes(self._base)
        self.back = _bytes(back_hair(HEAD, self.look, self.place, self.rng))
        self._patches = {}

    def _eyes(self, closed: int, lift: int) -> NDArray[np.uint8]:
        key = ("eyes", closed, lift)
        if key not in self._patches:
            patch = self._base[_crop(_EYES)].copy()
            for side in (-1, 1):
                _eye(_EYES, patch, self.look, side, closed / (_LEVELS - 1))
                _brow(_EYES, patch, self.look, side, lift / (_LEVELS - 1))
            if self.look.glasses:
                _glasses(_EYES, patch)
            self._patches[key] = _bytes(patch)
        return self._patches[key]

    def _mouth(self, gap: int, width: int) -> NDArray[np.uint8]:
        key = ("mouth", gap, width)
        if key not in self._patches:
            patch = self._base[_crop(_MOUTH)].copy()
            _lips(_MOUTH, patch, self.look, gap / 9, 0.72 + 0.36 * width / 5)
            self._patches[key] = _bytes(patch)
        return self._patches[key]

    def sprite(self, closed: float, lift: float, gap: float, width: float) -> NDArray[np.uint8]:
        """The head (H, W, 4) uint8 with an expression.

        Args:
            closed: eyelids, 0 open to 1 closed.
            lift: eyebrows, 0 to 1.
            gap: mouth, 0 closed to 1 wide open.
            width: mouth, 0 rounded to 1 spread.
        """
        out = self._whole.copy()
        level = _LEVELS - 1
        eyes = round(np.clip(closed, 0, 1) * level), round(np.clip(lift, 0, 1) * level)
        mouth = round(np.clip(gap, 0, 1) * 9), round(np.clip(width, 0, 1) * 5)
        out[_crop(_EYES)] = self._eyes(*eyes)
        out[_crop(_MOUTH)] = self._mouth(*mouth)
        return out
