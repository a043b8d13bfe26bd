"""Hair of the presenters: outlines, strands and sheen."""

import cv2
import numpy as np

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
