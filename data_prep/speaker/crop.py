"""The speaker in a picture: who it is, and the one square crop for photos and videos."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from data_prep.errors import BadInput, check_choice
from data_prep.rates import IMAGE_SIZE
from data_prep.speaker.faces import Detector, Face, find_faces, find_people, median_face

__all__ = ["Crop", "Detector", "Face", "find_faces", "find_people", "median_face"]

SIDE_IN_FACES = 4.2
"""Side of the crop in face heights: head, upper body and the reach of the hands."""

FACE_DOWN = 0.27
"""Height of the face's centre from the top of the crop, in sides."""

MIN_SIDE_IN_FACES = 1.4
"""Smallest crop around a face; a picture narrower than this is continued by its edges."""

PEOPLE = ("left", "right", "largest")
"""Ways to choose one of several people."""


@dataclass(frozen=True)
class Crop:
    """A square of a picture; it may reach outside, where the edges are continued.

    Attributes:
        x: left edge in pixels.
        y: top edge in pixels.
        size: side in pixels.
    """

    x: int
    y: int
    size: int


def choose_person(faces: Sequence[Face], person: str) -> int:
    """Number of the face that a person of `PEOPLE` names.

    Raises:
        BadInput: no such way to choose.
    """
    check_choice("--person", person, PEOPLE)
    numbers = range(len(faces))
    if person == "largest":
        return max(numbers, key=lambda i: faces[i].h)
    across = min if person == "left" else max
    return across(numbers, key=lambda i: faces[i].centre_x)


def speaker_crop(face: Face, height: int, width: int) -> Crop:
    """The square around a speaker, from the face only: upper body and reach of the hands.

    The side is `SIDE_IN_FACES` face heights with the face in the middle, `FACE_DOWN` from the
    top. A square that leaves the picture is moved inside; one larger than the picture shrinks
    to its shorter side, but not below `MIN_SIDE_IN_FACES` face heights.

    Args:
        face: the speaker's face; for a video the median over its frames.
        height: of the picture in pixels.
        width: of the picture in pixels.
    """
    least = MIN_SIDE_IN_FACES * face.h
    side = max(min(SIDE_IN_FACES * face.h, height, width), least)

    def place(wanted: float, length: int) -> float:
        if side >= length:
            return (length - side) / 2
        return min(max(wanted, 0.0), length - side)

    x = place(face.centre_x - side / 2, width)
    y = place(face.centre_y - FACE_DOWN * side, height)
    size = round(side)
    return Crop(min(round(x), max(width - size, 0)), min(round(y), max(height - size, 0)), size)


def check_crop(crop: Crop, height: int, width: int, option: str = "--crop") -> None:
    """Refuse a square that shows nothing of a picture, or is absurdly larger than it.

    Raises:
        BadInput: which bound is passed.
    """
    outside = crop.x >= width or crop.y >= height or min(crop.x, crop.y) <= -crop.size
    if crop.size < 1 or outside:
        raise BadInput(f"{option}: the square lies outside of the picture ({width}x{height})")
    if crop.size > 4 * max(height, width):
        raise BadInput(f"{option}: the square is too large for the picture ({width}x{height})")


def part_outside(crop: Crop, height: int, width: int) -> float:
    """Part of a square, 0 to 1, that lies outside of a picture."""
    across = min(crop.x + crop.size, width) - max(crop.x, 0)
    down = min(crop.y + crop.size, height) - max(crop.y, 0)
    return 1.0 - max(across, 0) * max(down, 0) / crop.size**2


def cut_out(image: np.ndarray, crop: Crop, size: int = IMAGE_SIZE) -> np.ndarray:
    """Cut a square out of a picture and bring it to a size, without aliasing.

    Args:
        image: `(H, W, 3)` uint8 RGB.
        crop: the square; where it leaves the picture the edge pixels are repeated.
        size: side of the result in pixels.

    Returns:
        pixels `(size, size, 3)` uint8 RGB.
    """
    height, width = image.shape[:2]
    right, bottom = crop.x + crop.size, crop.y + crop.size
    outside = (max(-crop.y, 0), max(bottom - height, 0), max(-crop.x, 0), max(right - width, 0))
    rows = slice(min(max(crop.y, 0), height - 1), min(max(bottom, 1), height))
    columns = slice(min(max(crop.x, 0), width - 1), min(max(right, 1), width))
    part = image[rows, columns]
    if any(outside):
        part = cv2.copyMakeBorder(part, *outside, cv2.BORDER_REPLICATE)
        part = part[: crop.size, : crop.size]
    method = cv2.INTER_AREA if crop.size > size else cv2.INTER_CUBIC
    return np.ascontiguousarray(cv2.resize(part, (size, size), interpolation=method))
