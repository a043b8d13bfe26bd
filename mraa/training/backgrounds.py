"""A person before a blue screen, put before other backgrounds.

Backgrounds are scikit-image's sample photos (public domain or CC0; none shows a person), drawn
rooms, plain walls and gradients.
"""

import functools

import cv2
import numpy as np
from numpy.typing import NDArray

SIDE = 320
"""Pixels of the side of a background."""

PHOTOS = ("coffee", "rocket", "chelsea", "grass", "gravel", "brick", "coins", "moon")
"""Sample photos in scikit-image's wheel itself."""

GREYS = PHOTOS[3:]
"""Those that are grey, and are tinted."""

ROOMS = 56
"""Rooms that are drawn."""

GREY = (104, 104, 104)
"""Colour, RGB, that a keyed person is laid over."""

LEAST_BLUE, LEAST_SHARE, SPREAD = 40.0, 0.2, 14.0
"""A blue screen: how blue it is, of 255; the part of the picture that it fills; and the standard
deviation of its colour about a smooth one."""

LIGHT = ((1.0, 1.4), (0.95, 1.15), (0.72, 1.05))
"""Range of the factors of red, green and blue that a keyed person is lit with: blue screens are lit
coldly."""

TINT = 0.2
"""Part of a background's colour that falls on the person."""


class Screen:
    """A person before a blue screen, keyed.

    The screen's colour is a quadratic over the picture, fitted to what is plainly blue. How blue a
    pixel is, `min(G, B) - R`, falls from the screen's value to nothing over the person's edge.

    Args:
        picture: (H, W, 3) uint8 RGB, a frame; later ones have the same screen.
    """

    def __init__(self, picture: NDArray[np.uint8]) -> None:
        y, x = np.mgrid[-1 : 1 : picture.shape[0] * 1j, -1 : 1 : picture.shape[1] * 1j]
        self.basis = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], -1).astype(np.float32)
        image = picture.astype(np.float32)
        blue = _blue(image)
        self.level = float(np.percentile(blue, 95))
        plain = (blue > 0.75 * self.level).astype(np.uint8)
        plain = cv2.erode(plain, np.ones((5, 5), np.uint8)).astype(bool)
        self.share = float(plain.mean())
        self.spread = np.inf
        if not plain.any():
            self.colour = np.zeros_like(image)
            return
        fit = np.linalg.lstsq(self.basis[plain], image[plain], rcond=None)[0]
        self.colour = self.basis @ fit
        self.spread = float((image - self.colour)[plain].std())

    @property
    def there(self) -> bool:
        """Whether the picture has a blue screen at all."""
        return self.level > LEAST_BLUE and self.share > LEAST_SHARE and self.spread < SPREAD

    def key(self, picture: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """The person over `GREY` (H, W, 3) uint8, and the matte (H, W) uint8."""
        image = picture.astype(np.float32)
        share = _blue(image) / np.maximum(_blue(self.colour), 30)
        matte = 1 - np.clip((share - 0.12) / (0.86 - 0.12), 0, 1)
        matte = matte * matte * (3 - 2 * matte)
        person = np.clip(image - (1 - matte)[..., None] * self.colour, 0, 255)
        spill = np.maximum(np.minimum(person[..., 1], person[..., 2]) - person[..., 0], 0)
        person[..., 1] -= spill
        person[..., 2] -= spill
        # what was blue by spill was light all the same
        person += 0.3 * spill[..., None]
        over = person + (1 - matte)[..., None] * np.array(GREY, np.float32)
        return _bytes(over), _bytes(255 * matte)


def exchanged(
    pair: NDArray[np.uint8], screen: Screen, random: np.random.Generator
) -> NDArray[np.uint8]:
    """Frames (2, H, W, 3) uint8 of a person before a screen, both lit alike before another ground.

    Args:
        pair: the frames.
        screen: of them.
        random: what is random about ground and light.
    """
    ground = background(pair.shape[1], screen, random)
    light = np.array([random.uniform(*bounds) for bounds in LIGHT]) * random.uniform(0.8, 1.25)
    tint = ground.mean((0, 1)) / max(float(ground.mean()), 12.0)
    light *= 1 + TINT * (np.clip(tint, 0.5, 1.5) - 1)
    made = []
    for frame in pair:
        over, matte = screen.key(frame)
        bare = (1 - matte.astype(np.float32) / 255)[..., None]
        person = np.clip(over - bare * np.array(GREY, np.float32), 0, 255) * light.astype(
            np.float32
        )
        made.append(_bytes(person + bare * ground))
    return np.stack(made)


def background(side: int, screen: Screen, random: np.random.Generator) -> NDArray[np.float32]:
    """A background (side, side, 3) in [0, 255]: of the bank, plain, or the screen lit anew."""
    kind = random.random()
    if kind < 0.5:
        image = bank()[int(random.integers(len(bank())))]
        part = round(SIDE * random.uniform(0.5, 1))
        x, y = random.integers(0, SIDE - part + 1, 2)
        cut = image[y : y + part, x : x + part, :][:, :: int(random.choice([-1, 1]))]
        ground = cv2.resize(np.ascontiguousarray(cut), (side, side)).astype(np.float32)
        return np.asarray(ground * random.uniform(0.5, 1.2), np.float32).clip(0, 255)
    angle = random.uniform(0, 2 * np.pi)
    line = np.linspace(-0.7, 0.7, side)
    along = (np.cos(angle) * line + np.sin(angle) * line[:, None])[..., None]
    if kind < 0.85:
        colour = random.random(3)
        colour = colour.mean() + random.random() * (colour - colour.mean())
        plain = colour + random.uniform(-0.3, 0.3) * along + 0.05 * random.uniform(-1, 1, 3)
        return np.clip(255 * plain, 0, 255).astype(np.float32)
    lit = screen.colour * random.uniform(0.8, 1.15) * (1 + 0.15 * along)
    return np.asarray(lit, np.float32).clip(0, 255)


@functools.cache
def bank() -> list[NDArray[np.uint8]]:
    """Pictures (320, 320, 3) uint8 RGB, always the same: photos and rooms."""
    random = np.random.default_rng(1)
    return photos() + [room(random) for _ in range(ROOMS)]


def photos() -> list[NDArray[np.uint8]]:
    """Cuts of the sample photos, each sharp and blurred, RGB."""
    import skimage.data

    random, found = np.random.default_rng(0), []
    for name in PHOTOS:
        try:
            image = getattr(skimage.data, name)()
        except Exception:  # some releases fetch what others bring along
            continue
        image = image if image.ndim == 3 else np.repeat(image[..., None], 3, 2)
        if name in GREYS:
            image = np.clip(image * random.uniform(0.5, 1.1, 3), 0, 255).astype(np.uint8)
        for blur in (0, 2.5, 7):
            side = int(min(image.shape[:2]) * random.uniform(0.6, 1))
            y, x = (int(random.integers(0, n - side + 1)) for n in image.shape[:2])
            part = cv2.resize(image[y : y + side, x : x + side, :3], (SIDE, SIDE))
            soft = cv2.GaussianBlur(part, (0, 0), blur) if blur else part
            found.append(np.asarray(soft, np.uint8))
    return found


def room(random: np.random.Generator) -> NDArray[np.uint8]:
    """A drawn room: wall, floor or skirting, shelves, pictures, a window, a lamp's light."""
    wall = random.uniform(60, 240) + random.uniform(-25, 25, 3)
    y, x = np.mgrid[0 : 1 : SIDE * 1j, 0 : 1 : SIDE * 1j]
    image = np.full((SIDE, SIDE, 3), wall, np.float32)
    if random.random() < 0.4:  # stripes or boards
        wave = np.sin(2 * np.pi * x * random.integers(4, 22)) * random.uniform(2, 12)
        image += np.sign(wave)[..., None] * abs(wave)[..., None] * 0.7
    for _ in range(random.integers(0, 9)):
        _furnish(image, random)
    if random.random() < 0.5:
        top, colour = int(SIDE * random.uniform(0.72, 0.95)), random.uniform(30, 170, 3).tolist()
        cv2.rectangle(image, (0, top), (SIDE, SIDE), colour, -1)
    centre = random.uniform(-0.2, 1.2, 2)
    glow = np.exp(-((x - centre[0]) ** 2 + (y - centre[1]) ** 2) * random.uniform(0.5, 3))
    image *= (0.65 + 0.5 * glow)[..., None].astype(np.float32)
    image += random.normal(0, 3, image.shape)
    blur = float(random.choice([0.6, 1.5, 4.0]))
    return np.clip(cv2.GaussianBlur(image, (0, 0), blur), 0, 255).astype(np.uint8)


def _furnish(image: NDArray[np.float32], random: np.random.Generator) -> None:
    """Draw a framed box, sometimes with books, panes or slats."""
    left, top = (int(v) for v in random.integers(-40, SIDE, 2))
    wide, high = (int(v) for v in random.integers(14, 150, 2))
    colour, corner = random.uniform(20, 240, 3), (left + wide, top + high)
    cv2.rectangle(image, (left, top), corner, (colour * 0.6).tolist(), -1)
    inner = (left + 3, top + 3), (corner[0] - 3, corner[1] - 3)
    cv2.rectangle(image, *inner, colour.tolist(), -1)
    if random.random() < 0.5:
        for at in range(left + 6, corner[0] - 4, int(random.integers(5, 22))):
            tone = (random.uniform(20, 230, 3)).tolist()
            cv2.line(image, (at, top + 5), (at, corner[1] - 5), tone, 3)


def _bytes(image: NDArray) -> NDArray[np.uint8]:
    return np.rint(np.clip(image, 0, 255)).astype(np.uint8)


def _blue(image: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray(np.minimum(image[..., 1], image[..., 2]) - image[..., 0])
