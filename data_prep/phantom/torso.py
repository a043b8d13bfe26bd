"""The torso: neck, chest and clothes as one shaded sprite.

The origin is the pit of the neck; the chin is at y = -28 and the shoulder joints at
(+-shoulders, 26).
"""

import numpy as np
from numpy.typing import NDArray

from data_prep.phantom.head import tinted
from data_prep.phantom.paint import (
    Array,
    Canvas,
    blur,
    bump,
    cover,
    darken,
    inflate,
    lambert,
    mirrored,
    noise,
    sample,
    smooth,
)
from data_prep.phantom.presenters import Look, Setting

TORSO = Canvas(-140, -60, 140, 250, 2.0)
"""Raster of the torso, in units about the pit of the neck."""

TILE_DENSITY = 1.7
"""Pixels of a cloth tile a unit, on torso and sleeves alike."""


def _outline(look: Look) -> Array:
    s, g = look.shoulders, look.girth
    half = [(0, -14), (17, -15), (28, -6), (s * 0.62, 3), (s * 0.92, 9), (s + 9, 19)]
    half += [(s + 15, 38), (s + 2, 64), (s - 9, 96), (66 * g, 150), (68 * g, 200), (72 * g, 252)]
    return smooth(mirrored([*half, (0, 256)]))


def _skin(look: Look, place: Setting) -> Array:
    sprite = np.zeros((*TORSO.shape, 4), np.float32)
    x, y = TORSO.grid()
    width = 19.5 * look.girth * look.face_width
    neck = [(0, -58), (width * 0.97, -56), (width * 0.95, -34), (width, -18), (width + 8, -7)]
    mask = TORSO.fill(smooth(mirrored([*neck, (38, 12), (44, 60), (0, 72)])), 0.3)
    relief = inflate(mask, 24 * TORSO.density, 4.0)
    for side in (-1, 1):
        relief = relief + 2.2 * bump(x, y, side * 24, 5 - 0.1 * 24, 20, 2.4)
        relief = relief + 3.0 * bump(x, y, side * (6 - 0.12 * (y + 20)), -22, 2.4, 15)
    relief = relief - 4 * bump(x, y, 0, 2, 4, 4)
    shade = 1 - 0.52 / (1 + np.exp((y + 19 - 0.006 * x * x) / 4.0))
    light = lambert(relief.astype(np.float32), place.light, 0.5) * shade
    cover(sprite, np.clip(tinted(look.skin, (light * 0.97).astype(np.float32)), 0, 1), mask)
    return sprite


def _neckline(garment: str, width: float) -> Array:
    """What the garment leaves free at the neck, a polygon (n, 2)."""
    if garment == "tee":
        return smooth(mirrored([(0, -40), (width + 5, -20), (width + 6, -4), (15, 11), (0, 15)]))
    if garment == "sweater":
        return smooth(mirrored([(0, -40), (width + 2, -20), (width + 2, -8), (13, 3), (0, 6)]))
    if garment == "blouse":
        return np.array(
            [(-width - 7, -14), (-width - 4, -40), (width + 4, -40), (width + 7, -14), (0, 46)]
        )
    deep = 96 if garment == "blazer" else 10
    corners = [(-width, -18), (-width, -40), (width, -40), (width, -18), (0, deep)]
    return np.array(corners, np.float32)


def _folds(rng: np.random.Generator, look: Look) -> Array:
    """Wrinkles of the cloth (H, W) in pixels of height."""
    x, y = TORSO.grid()
    relief = 2.6 * blur(noise(rng, *TORSO.shape, 1.5), 2)
    for side in (-1, 1):
        for _ in range(5):
            cy, slope = rng.uniform(40, 210), rng.uniform(-0.9, 0.9)
            cx = side * rng.uniform(0.45, 0.95) * look.shoulders
            across = (y - cy) - side * slope * (x - cx)
            crease = np.exp(-0.5 * (across / 3.2) ** 2) * np.exp(-0.5 * ((x - cx) / 24) ** 2)
            relief = relief - float(rng.uniform(1.5, 4.0)) * crease
    return relief.astype(np.float32)


def _cloth(look: Look, place: Setting, tile: Array, rng: np.random.Generator) -> Array:
    sprite = np.zeros((*TORSO.shape, 4), np.float32)
    mask = TORSO.fill(_outline(look), 0.3)
    x, y = TORSO.grid()
    relief = inflate(mask, 62 * TORSO.density, 5.0) * 0.8
    relief = relief + 9 * bump(x, y, -30, 68, 24, 30) + 9 * bump(x, y, 30, 68, 24, 30)
    relief = (relief + _folds(rng, look)).astype(np.float32)
    light = lambert(relief, place.light, 0.45)
    u = x * TILE_DENSITY - 0.04 * relief + 0 * y
    v = y * TILE_DENSITY + 0.05 * relief + 0 * x
    colour = sample(tile, u.astype(np.float32), v.astype(np.float32)) * light[..., None]
    cover(sprite, np.clip(colour, 0, 1), mask)
    for side in (-1, 1):
        seam = [(side * (look.shoulders - 8), 5), (side * (look.shoulders - 14), 40)]
        seam += [(side * (look.shoulders - 11), 78)]
        darken(sprite, TORSO.stroke(smooth(seam, closed=False), 2.5, 2.0), 0.35)
    return sprite


def _collar(sprite: Array, colour: NDArray, width: float, light: Array) -> None:
    for side in (-1, 1):
        wing = [(side * (width + 3), -21), (side * (width + 8), -6), (side * 13, 18), (0, 1)]
        wing += [(side * 6, -3), (side * (width - 1), -14)]
        flap = TORSO.fill(np.array(wing), 0.3)
        darken(sprite, np.roll(blur(flap, 3), (5, 0), (0, 1)) * (1 - flap), 0.4)
        cover(sprite, np.clip(colour * (1.04 * light)[..., None], 0, 1), flap)
        edge = TORSO.stroke(np.array([*wing[:4]]), 0.9, 0.3)
        darken(sprite, edge, 0.3)


def _buttons(sprite: Array, top: float, bottom: float, step: float, colour: NDArray) -> None:
    x, y = TORSO.grid()
    darken(sprite, TORSO.stroke(np.array([(-4.5, top - 6), (-4.5, bottom)]), 0.8, 0.4), 0.3)
    for centre in np.arange(top, bottom, step):
        radius = np.hypot(x, y - centre)
        darken(sprite, np.clip(2.9 - radius, 0, 1), 0.4)
        cover(sprite, colour, (np.clip((2.1 - radius) * 2, 0, 1) * 0.9).astype(np.float32))


def _lapels(sprite: Array, tile: Array, light: Array) -> None:
    x, y = TORSO.grid()
    weave = sample(tile, 0.8 * x * TILE_DENSITY + 0.6 * y, 0.8 * y * TILE_DENSITY - 0.6 * x)
    for side in (-1, 1):
        flap = [(side * 21, -17), (side * 33, -3), (side * 44, 30), (side * 33, 34)]
        flap += [(side * 38, 43), (0, 108), (side * 3, 82), (side * 12, 40)]
        mask = TORSO.fill(np.array(flap), 0.3)
        darken(sprite, blur(np.roll(mask, (5, side * 5), (0, 1)), 4) * (1 - mask), 0.42)
        cover(sprite, np.clip(weave * (1.06 * light)[..., None], 0, 1), mask)
        darken(sprite, TORSO.stroke(np.array([*flap[1:6]]), 1.0, 0.4), 0.35)
    darken(sprite, TORSO.stroke(np.array([(0, 106), (3, 180), (10, 250)]), 1.4, 0.8), 0.45)


def _tie(sprite: Array, colour: NDArray, light: Array, rng: np.random.Generator) -> None:
    knot = [(-7, -2), (7, -2), (4.5, 11), (-4.5, 11)]
    blade = [(-4, 11), (4, 11), (11, 96), (0, 112), (-11, 96)]
    x, y = TORSO.grid()
    stripe = 1 + 0.22 * np.sign(np.sin((x * 0.8 + y) * float(rng.uniform(0.3, 0.7))))
    tone = (light * stripe).astype(np.float32)
    for shape, gain in ((blade, 0.92), (knot, 1.08)):
        mask = TORSO.fill(np.array(shape), 0.3)
        darken(sprite, blur(np.roll(mask, 4, 0), 3) * (1 - mask), 0.35)
        cover(sprite, np.clip(colour * (gain * tone)[..., None], 0, 1), mask)


def torso(look: Look, place: Setting, tile: Array, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Neck, chest and clothes, (H, W, 4) uint8 on `TORSO`.

    Args:
        look: the presenter's looks.
        place: clothes and light of the video.
        tile: cloth, (TILE, TILE, 3).
        rng: source of randomness.
    """
    sprite = _skin(look, place)
    width = 19.5 * look.girth * look.face_width
    body = _cloth(look, place, tile, rng)
    light = lambert(inflate(body[..., 3], 62 * TORSO.density, 5.0) * 0.8, place.light, 0.5)
    under = np.asarray(place.under, np.float32)
    hole = TORSO.fill(_neckline(place.garment, width), 0.4)
    mask = body[..., 3] * (1 - hole)
    if place.garment in ("blazer", "sweater"):
        chest = body[..., 3] * TORSO.fill(
            np.array(
                [(-40, -8), (-width, -20), (0, 7), (width, -20), (40, -8), (30, 120), (-30, 120)]
            )
        )
        soft = under * (light * (1 + 0.02 * noise(rng, *TORSO.shape, 1.0)))[..., None]
        if place.garment == "blazer" or rng.random() < 0.4:
            cover(sprite, np.clip(soft, 0, 1), chest)
    if place.garment == "blazer" and rng.random() < 0.6:
        _tie(sprite, np.asarray(place.second, np.float32) * 0.8, light, rng)
    elif place.garment == "blazer":
        _buttons(sprite, 20, 110, 22, under * 0.8)
    darken(sprite, blur(np.roll(mask, -4, 0), 3) * (1 - mask), 0.3)
    cover(sprite, body[..., :3], mask)
    if place.garment in ("tee", "sweater", "blouse"):
        rim = blur(hole, 3.0)
        darken(sprite, 4 * rim * (1 - rim) * mask, 0.22)
    if place.garment == "shirt":
        _buttons(sprite, 26, 250, 27, under)
        _collar(sprite, np.asarray(tile.mean((0, 1)), np.float32), width, light)
    if place.garment == "blazer":
        _collar(sprite, under, width, light)
        _lapels(sprite, tile, light)
    return np.clip(sprite * 255 + 0.5, 0, 255).astype(np.uint8)
