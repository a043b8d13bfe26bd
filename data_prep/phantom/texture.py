"""Repeating textures of cloth and wood, and natural noise, all from a generator."""

import cv2
import numpy as np
from numpy.typing import NDArray

from data_prep.phantom.paint import Array, blur

TILE = 256
"""Side of a texture tile in pixels; tiles repeat without a seam."""

CLOTHS = ("plain", "stripes", "bands", "checks", "herringbone", "knit", "dots", "tweed", "leaves")
"""Names of the cloth patterns."""


def noise(rng: np.random.Generator, height: int, width: int, slope: float = 1.6) -> Array:
    """Random field (height, width) of zero mean, unit variance and spectrum 1 / f^slope.

    The field repeats without a seam. A slope of 2 in power is that of natural photographs
    (Field 1987); here `slope` is of amplitude, so that 1 is photograph-like and more is smoother.
    """
    fy, fx = np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width)[None, :]
    radius = np.hypot(fy, fx)
    radius[0, 0] = 1
    spectrum = np.exp(2j * np.pi * rng.random(radius.shape)) / radius**slope
    spectrum[0, 0] = 0
    field = np.fft.irfft2(spectrum, (height, width))
    return (field / field.std()).astype(np.float32)


def _wrapped(field: Array, sigma: float) -> Array:
    margin = 32
    padded = np.pad(field, margin, mode="wrap")
    return blur(padded, sigma)[margin:-margin, margin:-margin]


def _leaves(rng: np.random.Generator) -> Array:
    tile = np.zeros((TILE * 3, TILE * 3), np.uint8)
    for _ in range(26):
        x, y = rng.integers(0, TILE, 2)
        axes = (int(rng.integers(10, 17)), int(rng.integers(4, 8)))
        angle = float(rng.uniform(0, 180))
        for dx in (0, TILE, 2 * TILE):
            for dy in (0, TILE, 2 * TILE):
                centre = (int(x) + dx, int(y) + dy)
                cv2.ellipse(tile, centre, axes, angle, 0, 360, (255,), -1, cv2.LINE_AA)
    return tile[TILE : 2 * TILE, TILE : 2 * TILE].astype(np.float32) / np.float32(255)


def _pattern(rng: np.random.Generator, kind: str) -> Array:
    """Where the second colour shows, (TILE, TILE) in [0, 1]."""
    y, x = np.mgrid[0:TILE, 0:TILE].astype(np.float32)
    period = TILE / int(rng.choice([6, 8, 10]))
    fine = TILE / int(rng.choice([20, 26, 32]))
    if kind == "stripes":
        return ((x % period) < period * rng.uniform(0.18, 0.5)).astype(np.float32)
    if kind == "bands":
        return ((y % period) < period * rng.uniform(0.3, 0.5)).astype(np.float32)
    if kind == "checks":
        wide = period * rng.uniform(0.3, 0.5)
        return (0.5 * ((x % period) < wide) + 0.5 * ((y % period) < wide)).astype(np.float32)
    if kind == "herringbone":
        zig = np.abs((y % (2 * fine)) - fine)
        return (((x + zig) % fine) < fine / 2).astype(np.float32)
    if kind == "knit":
        stitch = np.abs((x % fine) / fine - 0.5) * fine
        return (0.5 + 0.5 * np.sin(2 * np.pi * (y + stitch) / (fine * 0.75))).astype(np.float32)
    if kind == "dots":
        row = (y // period) % 2
        dx = (x + row * period / 2) % period - period / 2
        dy = y % period - period / 2
        return (np.hypot(dx, dy) < period * 0.2).astype(np.float32)
    if kind == "leaves":
        return _leaves(rng)
    slope = 0.35 if kind == "tweed" else 1.0
    return np.clip(0.5 + 0.25 * noise(rng, TILE, TILE, slope), 0, 1).astype(np.float32)


def cloth(
    rng: np.random.Generator, kind: str, first: NDArray, second: NDArray, contrast: float = 1.0
) -> Array:
    """A cloth tile (TILE, TILE, 3), two colours in the pattern `kind` with weave and mottling.

    Args:
        rng: source of randomness.
        kind: one of `CLOTHS`.
        first: (3,) ground colour.
        second: (3,) colour of the pattern.
        contrast: how far the pattern goes towards the second colour.
    """
    where = _wrapped(_pattern(rng, kind), 0.9) * contrast
    if kind in ("plain", "tweed"):
        where = where * 0.45
    ground, figure = np.asarray(first, np.float32), np.asarray(second, np.float32)
    tile = ground + (figure - ground) * where[..., None]
    y, x = np.mgrid[0:TILE, 0:TILE].astype(np.float32)
    weave = 0.025 * np.sin(np.pi * x / 2) * np.sin(np.pi * y / 2)
    grain = 1 + weave + 0.045 * noise(rng, TILE, TILE, 0.5) + 0.03 * noise(rng, TILE, TILE, 1.4)
    return np.clip(tile * grain[..., None], 0, 1).astype(np.float32)


def wood(rng: np.random.Generator, height: int, width: int, colour: NDArray) -> Array:
    """A wooden surface (height, width, 3) with grain along x."""
    warp = noise(rng, height, width, 1.8) * 6
    stretched = cv2.resize(noise(rng, height, max(8, width // 16), 1.0), (width, height))
    rings = 0.5 + 0.5 * np.sin((np.arange(height)[:, None] + warp) / 3.1)
    tone = 1 - 0.14 * rings + 0.06 * stretched + 0.02 * noise(rng, height, width, 0.3)
    return np.clip(np.asarray(colour, np.float32) * tone[..., None], 0, 1).astype(np.float32)


def sample(tile: Array, u: Array, v: Array) -> Array:
    """Colours (H, W, 3) of a tile at texture coordinates in pixels, repeating."""
    return cv2.remap(  # type: ignore[return-value]
        tile,
        np.mod(u, TILE - 1).astype(np.float32),
        np.mod(v, TILE - 1).astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_WRAP,
    )
