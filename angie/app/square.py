"""The square of a photo that will move, drawn into it, and moved."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from angie.source import photo_crop
from data_prep.errors import BadInput
from data_prep.media.photo import read_photo
from data_prep.speaker.crop import Crop

SHOWN = 560
"""Pixels of the longer side of the picture that shows it."""

SMALLEST = 32
"""Pixels of the smallest square."""


def found_square(photo: Path) -> tuple[Crop, tuple[int, int], str]:
    """The square around the speaker, width and height of the photo, and what is to be known.

    Where no person is found it is the largest square in the middle.

    Raises:
        BadInput: a photo that cannot be read.
    """
    pixels = read_photo(photo)
    height, width = pixels.shape[:2]
    try:
        return photo_crop(photo, pixels, "largest", with_crop=False), (width, height), ""
    except BadInput:
        side = min(width, height)
        middle = Crop((width - side) // 2, (height - side) // 2, side)
        return middle, (width, height), "No face was found; move the square to the person."


def with_square(photo: Path, crop: Crop) -> NDArray[np.uint8]:
    """The photo, reduced, with the square bright and what is outside of it dark."""
    pixels = read_photo(photo)
    scale = min(1.0, SHOWN / max(pixels.shape[:2]))
    size = (max(1, round(pixels.shape[1] * scale)), max(1, round(pixels.shape[0] * scale)))
    small = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8)
    left, top = round(crop.x * scale), round(crop.y * scale)
    right, bottom = (corner + round(crop.size * scale) for corner in (left, top))
    drawn = small // 3
    inside = slice(max(top, 0), max(bottom, 0)), slice(max(left, 0), max(right, 0))
    drawn[inside] = small[inside]
    cv2.rectangle(drawn, (left, top), (right - 1, bottom - 1), (255, 190, 60), 2)
    return drawn


def moved_square(crop: Crop, place: tuple[int, int], size: tuple[int, int]) -> Crop:
    """The square with its middle where the shown picture was clicked.

    Args:
        crop: as it was.
        place: x and y in the shown picture.
        size: width and height of the photo.
    """
    scale = min(1.0, SHOWN / max(size))
    x, y = (round(value / scale) - crop.size // 2 for value in place)
    return Crop(x, y, crop.size)
