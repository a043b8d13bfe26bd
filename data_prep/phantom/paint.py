"""Painting still layers: smooth outlines, inflated shading and soft compositing.

Every layer lives on a `Canvas`, a raster of a rectangle given in figure units (one hundredth of
the height of a head, x right, y down). Colours are float32 RGB in [0, 1].

Repeating textures of cloth and wood, and natural noise, all from a generator.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]


@dataclass(frozen=True)
class Canvas:
    """A raster over the rectangle [x0, x1] by [y0, y1], `density` pixels a unit."""

    x0: float
    y0: float
    x1: float
    y1: float
    density: float

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in pixels."""
        return (
            round((self.y1 - self.y0) * self.density),
            round((self.x1 - self.x0) * self.density),
        )

    def grid(self) -> tuple[Array, Array]:
        """Unit coordinates of the pixel centres: x (1, W) and y (H, 1)."""
        height, width = self.shape
        x = self.x0 + (np.arange(width, dtype=np.float32) + 0.5) / self.density
        y = self.y0 + (np.arange(height, dtype=np.float32) + 0.5) / self.density
        return x[None, :].astype(np.float32), y[:, None].astype(np.float32)

    def pixels(self, points: NDArray) -> Array:
        """Unit points (n, 2) to pixel coordinates (n, 2), pixel centres at whole numbers."""
        origin = np.array([self.x0, self.y0], np.float32)
        return ((np.asarray(points, np.float32) - origin) * self.density - 0.5).astype(np.float32)

    def fill(self, points: NDArray, soft: float = 0.0) -> Array:
        """Coverage (H, W) in [0, 1] of a polygon (n, 2) in units, blurred by `soft` units."""
        mask = np.zeros(self.shape, np.uint8)
        fixed = np.round(self.pixels(points) * 256).astype(np.int32)
        cv2.fillPoly(mask, [fixed], (255,), cv2.LINE_AA, 8)
        return blur(mask.astype(np.float32) / np.float32(255), soft * self.density)

    def stroke(self, points: NDArray, width: float, soft: float = 0.0) -> Array:
        """Coverage (H, W) of an open line (n, 2) of `width` units."""
        mask = np.zeros(self.shape, np.uint8)
        fixed = np.round(self.pixels(points) * 256).astype(np.int32)
        thick = max(1, round(width * self.density))
        cv2.polylines(mask, [fixed], False, (255,), thick, cv2.LINE_AA, 8)
        return blur(mask.astype(np.float32) / np.float32(255), soft * self.density)


def blur(image: Array, sigma: float) -> Array:
    """Gaussian blur of (H, W) or (H, W, C) by `sigma` pixels; nothing below a tenth of one."""
    if sigma < 0.1:
        return image
    return cv2.GaussianBlur(image, (0, 0), sigma)  # type: ignore[return-value]


def smooth(points: Sequence[tuple[float, float]], closed: bool = True, steps: int = 12) -> Array:
    """Catmull-Rom curve (n * steps, 2) through the points."""
    p = np.asarray(points, np.float32)
    if closed:
        before, after, far = np.roll(p, 1, 0), np.roll(p, -1, 0), np.roll(p, -2, 0)
    else:
        padded = np.concatenate([p[:1], p, p[-1:], p[-1:]])
        before, p, after, far = padded[:-3], padded[1:-2], padded[2:-1], padded[3:]
    t = np.linspace(0, 1, steps, endpoint=False, dtype=np.float32)[:, None, None]
    curve = 0.5 * (
        2 * p
        + (after - before) * t
        + (2 * before - 5 * p + 4 * after - far) * t**2
        + (3 * p - before - 3 * after + far) * t**3
    )
    return curve.transpose(1, 0, 2).reshape(-1, 2)


def mirrored(right: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """An outline symmetric in x from its half with x >= 0, given from top to bottom."""
    return [*right] + [(-x, y) for x, y in reversed(right) if x > 0]


def inflate(mask: Array, radius: float, soft: float = 2.0) -> Array:
    """Height (H, W) in pixels of a pillow over the mask, round within `radius` of the edge."""
    inside = (mask > 0.5).astype(np.uint8)
    distance = cv2.distanceTransform(inside, cv2.DIST_L2, 5)
    rim = 1 - np.minimum(distance / radius, 1)
    return blur((radius * np.sqrt(1 - rim * rim)).astype(np.float32), soft)


def lambert(height: Array, light: tuple[float, float, float], ambient: float = 0.45) -> Array:
    """Diffuse light (H, W), about 1 where the surface faces the viewer.

    Args:
        height: (H, W) in pixels, towards the viewer.
        light: unit vector towards the light, x right, y down, z to the viewer.
        ambient: share of light that comes from everywhere.
    """
    dx = cv2.Sobel(height, cv2.CV_32F, 1, 0, scale=1 / 8)
    dy = cv2.Sobel(height, cv2.CV_32F, 0, 1, scale=1 / 8)
    facing = (light[2] - dx * light[0] - dy * light[1]) / np.sqrt(1 + dx * dx + dy * dy)
    return (ambient + (1 - ambient) * np.maximum(facing, 0) / light[2]).astype(np.float32)


def cover(sprite: Array, colour: NDArray | tuple[float, float, float], mask: Array) -> None:
    """Lay a colour, (3,) or (H, W, 3), over a sprite in place where `mask` (H, W) says.

    The sprite is (H, W, 4); its fourth channel is coverage, not premultiplied.
    """
    old = sprite[..., 3]
    new = mask + old * (1 - mask)
    share = mask / np.maximum(new, 1e-4)
    sprite[..., :3] += (np.asarray(colour, np.float32) - sprite[..., :3]) * share[..., None]
    sprite[..., 3] = new


def darken(sprite: Array, mask: Array, amount: float) -> None:
    """Multiply the colours of a sprite in place by 1 - amount where `mask` (H, W) says."""
    sprite[..., :3] *= (1 - amount * mask)[..., None]


def bump(x: Array, y: Array, cx: float | Array, cy: float | Array, sx: float, sy: float) -> Array:
    """Gaussian hill (H, W) of height one at (cx, cy) with widths (sx, sy)."""
    return np.exp(-0.5 * (((x - cx) / sx) ** 2 + ((y - cy) / sy) ** 2)).astype(np.float32)


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
