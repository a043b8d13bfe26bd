"""Backgrounds to put keyed people before: scikit-image's sample photos, blurred or not, and rooms.

    python scripts/draw_backgrounds.py ARCHIVE [--rooms 56]

Writes ARCHIVE/backgrounds.npz, `jpeg` (M,) object-free: one array of bytes and the end of each.
The photos lie in scikit-image's wheel (public domain or CC0; none shows a person); rooms are drawn.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np

SIDE = 320

PHOTOS = ("coffee", "rocket", "chelsea", "grass", "gravel", "brick", "coins", "moon")
"""Sample photos in the wheel itself."""


def photos() -> list[np.ndarray]:
    """Cuts of the sample photos, each sharp and blurred, RGB."""
    import skimage.data

    random, found = np.random.default_rng(0), []
    for name in PHOTOS:
        try:
            image = getattr(skimage.data, name)()
        except Exception:  # some releases fetch what others bring along
            continue
        image = image if image.ndim == 3 else np.repeat(image[..., None], 3, 2)
        if name in ("grass", "gravel", "brick", "coins", "moon"):  # grey ones are tinted
            image = np.clip(image * random.uniform(0.5, 1.1, 3), 0, 255).astype(np.uint8)
        for blur in (0, 2.5, 7):
            side = int(min(image.shape[:2]) * random.uniform(0.6, 1))
            y, x = (int(random.integers(0, n - side + 1)) for n in image.shape[:2])
            part = cv2.resize(image[y : y + side, x : x + side, :3], (SIDE, SIDE))
            found.append(cv2.GaussianBlur(part, (0, 0), blur) if blur else part)
    return found


def room(random: np.random.Generator) -> np.ndarray:
    """A drawn room: wall, floor or skirting, shelves, pictures, a window, a lamp's light."""
    wall = random.uniform(60, 240) + random.uniform(-25, 25, 3)
    y, x = np.mgrid[0 : 1 : SIDE * 1j, 0 : 1 : SIDE * 1j]
    image = np.full((SIDE, SIDE, 3), wall, np.float32)
    if random.random() < 0.4:  # stripes or boards
        wave = np.sin(2 * np.pi * x * random.integers(4, 22)) * random.uniform(2, 12)
        image += np.sign(wave)[..., None] * abs(wave)[..., None] * 0.7
    for _ in range(random.integers(0, 9)):
        left, top = random.integers(-40, SIDE, 2)
        wide, high = random.integers(14, 150, 2)
        colour = random.uniform(20, 240, 3)
        corner = (int(left + wide), int(top + high))
        cv2.rectangle(image, (int(left), int(top)), corner, (colour * 0.6).tolist(), -1)
        inner = (int(left) + 3, int(top) + 3), (corner[0] - 3, corner[1] - 3)
        cv2.rectangle(image, *inner, colour.tolist(), -1)
        if random.random() < 0.5:  # books, panes or slats
            for at in range(int(left) + 6, corner[0] - 4, int(random.integers(5, 22))):
                tone = (random.uniform(20, 230, 3)).tolist()
                cv2.line(image, (at, int(top) + 5), (at, corner[1] - 5), tone, 3)
    if random.random() < 0.5:
        cv2.rectangle(
            image,
            (0, int(SIDE * random.uniform(0.72, 0.95))),
            (SIDE, SIDE),
            random.uniform(30, 170, 3).tolist(),
            -1,
        )
    centre = random.uniform(-0.2, 1.2, 2)
    glow = np.exp(-((x - centre[0]) ** 2 + (y - centre[1]) ** 2) * random.uniform(0.5, 3))
    image *= (0.65 + 0.5 * glow)[..., None]
    image += random.normal(0, 3, image.shape)
    blur = random.choice([0.6, 1.5, 4.0])
    return np.clip(cv2.GaussianBlur(image, (0, 0), float(blur)), 0, 255).astype(np.uint8)


def main() -> None:
    """Write the bank."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("archive", type=Path)
    parser.add_argument("--rooms", type=int, default=56)
    given = parser.parse_args()
    random = np.random.default_rng(1)
    bank = photos() + [room(random) for _ in range(given.rooms)]
    coded = [cv2.imencode(".jpg", im[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])[1] for im in bank]
    ends = np.cumsum([len(c) for c in coded])
    np.savez(given.archive / "backgrounds.npz", jpeg=np.concatenate(coded).ravel(), ends=ends)
    print(f"{len(bank)} backgrounds, {ends[-1] / 2**20:.1f} MiB")


if __name__ == "__main__":
    main()
