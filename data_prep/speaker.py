"""The speaker in a picture: face detection and the one square crop for photos and videos."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from data_prep.errors import BadInput
from data_prep.rates import IMAGE_SIZE

SIDE_IN_FACES = 4.2
"""Side of the crop in face heights: head, upper body and the reach of the hands."""

FACE_DOWN = 0.27
"""Height of the face's centre from the top of the crop, in sides."""

MIN_SIDE_IN_FACES = 1.4
"""Smallest crop around a face; a picture narrower than this is continued by its edges."""

_SEARCH_SIDES = (480, 960)
"""Long side in pixels at which faces are sought; the second when the first finds none."""

_SMALLEST = 20
"""Pixels of the cascades' window."""

_NEAR_HEIGHT = 60
"""Pixels that a face has when only its neighbourhood is searched."""

_FRONTAL = ("frontalface_alt2", "frontalface_alt", "frontalface_default")
_SURE, _LIKELY = 25, 16
"""Overlapping hits, over all cascades, that make a face sure, or likely."""

_PROFILE_HITS = 6


@dataclass(frozen=True)
class Face:
    """A face's bounding box, from the brows to the chin.

    Attributes:
        x: left edge in pixels.
        y: top edge in pixels.
        w: width in pixels.
        h: height in pixels.
    """

    x: float
    y: float
    w: float
    h: float

    @property
    def centre_x(self) -> float:
        """Middle of the box in pixels from the left."""
        return self.x + self.w / 2

    @property
    def centre_y(self) -> float:
        """Middle of the box in pixels from the top."""
        return self.y + self.h / 2


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


@functools.cache
def _cascade(name: str) -> cv2.CascadeClassifier:
    path = Path(cv2.__file__).parent / "data" / f"haarcascade_{name}.xml"
    cascade = cv2.CascadeClassifier(str(path))
    if cascade.empty():
        raise RuntimeError(f"{path}: OpenCV was installed without its cascades")
    return cascade


def _hits(grey: np.ndarray, name: str, smallest: int) -> list[tuple[Face, int]]:
    boxes, counts = _cascade(name).detectMultiScale2(
        grey, scaleFactor=1.1, minNeighbors=2, minSize=(smallest, smallest)
    )
    return [(Face(*map(float, box)), int(n)) for box, n in zip(boxes, counts, strict=True)]


def _same(a: Face, b: Face) -> bool:
    apart = np.hypot(a.centre_x - b.centre_x, a.centre_y - b.centre_y)
    return bool(apart < 0.3 * max(a.w, b.w) and 0.6 < a.w / b.w < 1 / 0.6)


def _frontal(grey: np.ndarray, smallest: int) -> list[tuple[Face, int]]:
    """Faces that at least two of the cascades see, with the hits of all of them."""
    votes = [(face, n, name) for name in _FRONTAL for face, n in _hits(grey, name, smallest)]
    groups: list[list[tuple[Face, int, str]]] = []
    for vote in sorted(votes, key=lambda vote: -vote[1]):
        for group in groups:
            if _same(group[0][0], vote[0]):
                group.append(vote)
                break
        else:
            groups.append([vote])
    faces = []
    for group in groups:
        if len({name for *_, name in group}) >= 2:
            faces.append((median_face([face for face, *_ in group]), sum(n for _, n, _ in group)))
    return faces


def _profile(grey: np.ndarray, smallest: int) -> list[Face]:
    """Faces seen from either side; the cascade knows one side, the mirror gives the other."""
    width = grey.shape[1]
    hits = _hits(grey, "profileface", smallest)
    for face, n in _hits(np.ascontiguousarray(grey[:, ::-1]), "profileface", smallest):
        hits.append((Face(width - face.x - face.w, face.y, face.w, face.h), n))
    return [face for face, n in hits if n >= _PROFILE_HITS]


def median_face(faces: Sequence[Face]) -> Face:
    """The box in the middle of the given boxes, centre and size taken apart."""
    boxes = np.array([(f.centre_x, f.centre_y, f.w, f.h) for f in faces])
    x, y, w, h = np.median(boxes, axis=0).tolist()
    return Face(x - w / 2, y - h / 2, w, h)


def _search(grey: np.ndarray, near: Face | None) -> list[Face]:
    smallest = _SMALLEST if near is None else max(_SMALLEST, round(0.6 * near.h))
    found = _frontal(grey, smallest)
    sure = [face for face, n in found if n >= _SURE]
    likely = [face for face, n in found if n >= _LIKELY]
    return sure or _profile(grey, smallest) or likely


def find_faces(image: np.ndarray, near: Face | None = None) -> list[Face]:
    """Find the faces in a picture.

    Three of OpenCV's Haar cascades for frontal faces vote; what only one of them sees is
    dropped. Where no frontal face is sure, faces in profile are looked for.

    Args:
        image: `(H, W, 3)` uint8 RGB.
        near: where the face was a moment ago; only its neighbourhood is searched, fast.

    Returns:
        boxes in pixels of `image`, largest first.
    """
    if near is not None:
        height, width = image.shape[:2]
        left, top = max(0, int(near.x - near.w)), max(0, int(near.y - near.h))
        right, bottom = int(near.x + 2 * near.w), int(near.y + 2 * near.h)
        part = image[top : min(bottom, height), left : min(right, width)]
        if min(part.shape[:2]) < 20:
            return []
        scale = min(1.0, _NEAR_HEIGHT / near.h)
        return [
            Face(left + face.x, top + face.y, face.w, face.h)
            for face in _at_scale(part, scale, Face(0, 0, near.w * scale, near.h * scale))
        ]
    longest = max(image.shape[:2])
    for side in _SEARCH_SIDES:
        scale = min(side / longest, max(1.0, 320 / longest))
        faces = _at_scale(image, scale, None)
        if faces or scale >= 1:
            return faces
    return []


def _at_scale(image: np.ndarray, scale: float, near: Face | None) -> list[Face]:
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    method = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    grey = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=method)
    faces = _search(grey, near)
    scaled = [Face(f.x / scale, f.y / scale, f.w / scale, f.h / scale) for f in faces]
    return sorted(scaled, key=lambda face: -face.h)


def speaker_crop(face: Face, height: int, width: int) -> Crop:
    """The square around a speaker, from the face alone: upper body and reach of the hands.

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


def check_crop(crop: Crop, height: int, width: int) -> None:
    """Refuse a square that shows nothing of a picture, or is absurdly larger than it.

    Raises:
        BadInput: which bound is passed.
    """
    outside = crop.x >= width or crop.y >= height or min(crop.x, crop.y) <= -crop.size
    if crop.size < 1 or outside:
        raise BadInput(f"--crop: the square lies outside of the picture ({width}x{height})")
    if crop.size > 4 * max(height, width):
        raise BadInput(f"--crop: the square is too large for the picture ({width}x{height})")


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
