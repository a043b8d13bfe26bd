"""Faces in a picture."""

import functools
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

_SEARCH_SIDES = (480, 960)
"""Long side in pixels at which faces are sought; the second when the first finds none."""

_PHOTO_SIDES = (480, 960, 1600)
"""The same where everybody is sought, small faces too."""

_SMALLEST = 20
"""Pixels of the cascades' window."""

_NEAR_HEIGHT = 60
"""Pixels that a face has when only its neighbourhood is searched."""

_FRONTAL = ("frontalface_alt2", "frontalface_alt", "frontalface_default")
_SURE, _LIKELY = 25, 16
"""Overlapping hits, over all cascades, that make a face sure, or likely."""

_AGAIN = 8
"""Overlapping hits of the first cascade that make a face sure where there was one before."""

_PROFILE_HITS = 6

_COMPARABLE = 0.5
"""Height, in parts of the largest face's, from which a face counts as another person's."""


@dataclass(frozen=True)
class Face:
    """A face's bounding box, from the brows to the chin.

    Attributes:
        x: left edge in pixels.
        y: top edge in pixels.
        w: width in pixels.
        h: height in pixels.
        frontal: whether it is seen from the front, or only in profile.
    """

    x: float
    y: float
    w: float
    h: float
    frontal: bool = True

    @property
    def centre_x(self) -> float:
        """Middle of the box in pixels from the left."""
        return self.x + self.w / 2

    @property
    def centre_y(self) -> float:
        """Middle of the box in pixels from the top."""
        return self.y + self.h / 2

    def scaled(self, factor: float, x: float = 0.0, y: float = 0.0) -> "Face":
        """The box in a picture `factor` times as large, moved by `(x, y)` pixels after that."""
        return replace(
            self, x=self.x * factor + x, y=self.y * factor + y, w=self.w * factor, h=self.h * factor
        )


Detector = Callable[[np.ndarray], list[Face]]
"""Finds the faces in a picture `(H, W, 3)` RGB or `(H, W)` grey, uint8: boxes in its pixels,
largest first. It may miss small ones."""


@functools.cache
def _cascade(name: str) -> cv2.CascadeClassifier:
    path = Path(cv2.__file__).parent / "data" / f"haarcascade_{name}.xml"
    cascade = cv2.CascadeClassifier(str(path))
    if cascade.empty():
        raise RuntimeError(f"{path}: OpenCV was installed without its cascades")
    return cascade


_ONE_SEARCH = threading.Lock()
"""A cascade keeps its place in itself: two searches at once would disturb each other."""


def _hits(grey: np.ndarray, name: str, smallest: int) -> list[tuple[Face, int]]:
    with _ONE_SEARCH:
        boxes, counts = _cascade(name).detectMultiScale2(
            grey, scaleFactor=1.1, minNeighbors=2, minSize=(smallest, smallest)
        )
    return [
        (Face(float(x), float(y), float(w), float(h)), int(n))
        for (x, y, w, h), n in zip(boxes, counts, strict=True)
    ]


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
        hits.append((replace(face, x=width - face.x - face.w), n))
    return [replace(face, frontal=False) for face, n in hits if n >= _PROFILE_HITS]


def median_face(faces: Sequence[Face]) -> Face:
    """The box in the middle of the given boxes, centre and size taken apart."""
    boxes = np.array([(f.centre_x, f.centre_y, f.w, f.h) for f in faces])
    x, y, w, h = np.median(boxes, axis=0).tolist()
    frontal = 2 * sum(face.frontal for face in faces) >= len(faces)
    return Face(x - w / 2, y - h / 2, w, h, frontal)


def _search(grey: np.ndarray, near: Face | None) -> list[Face]:
    smallest = _SMALLEST if near is None else max(_SMALLEST, round(0.6 * near.h))
    if near is not None:
        again = [face for face, n in _hits(grey, _FRONTAL[0], smallest) if n >= _AGAIN]
        if again:
            return again
    found = _frontal(grey, smallest)
    sure = [face for face, n in found if n >= _SURE]
    likely = [face for face, n in found if n >= _LIKELY]
    return sure or _profile(grey, smallest) or likely


def find_faces(
    image: np.ndarray,
    near: Face | None = None,
    sides: Sequence[int] = _SEARCH_SIDES,
    detector: Detector | None = None,
) -> list[Face]:
    """Find the faces in a picture.

    Three of OpenCV's Haar cascades for frontal faces vote; what only one of them sees is
    dropped. Where no frontal face is sure, faces in profile are looked for. A detector is asked
    first where it is given, and the cascades look for what is too small for it.

    Args:
        image: `(H, W, 3)` uint8 RGB, or `(H, W)` grey.
        near: where the face was a moment ago; only its neighbourhood is searched, fast.
        sides: pixels of the long side at which the whole picture is searched; the next when
            the first finds no frontal face.
        detector: see `Detector`; None for the cascades alone.

    Returns:
        boxes in pixels of `image`, largest first.
    """
    if near is not None:
        return _find_near(image, near, detector)
    if detector is not None and (found := detector(image)):
        return found
    profiles: list[Face] = []
    for scale in _scales(image, sides):
        faces = _at_scale(image, scale, None)
        if any(face.frontal for face in faces):
            return faces
        profiles = profiles or faces
    return profiles


def newcomers(
    image: np.ndarray, known: Sequence[Face], side: int, detector: Detector | None = None
) -> bool:
    """Whether the whole picture may show another face than those known; a quarter of a search.

    Args:
        image: `(H, W)` uint8 grey.
        known: faces, in its pixels.
        side: pixels of the long side at which it is searched by the first cascade.
        detector: used in place of the cascade.
    """
    if detector is not None:
        hits = detector(image)
    else:
        scale = min(side / max(image.shape), 1.0)
        grey = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        found = _hits(grey, _FRONTAL[0], _SMALLEST)
        hits = [face.scaled(1 / scale) for face, n in found if n >= _AGAIN]
    return not all(any(_same(hit, one) or _on_body(hit, one) for one in known) for hit in hits)


def find_people(image: np.ndarray, detector: Detector | None = None) -> list[Face]:
    """Find the faces of everybody who counts in a picture, small ones too; slower.

    The picture is searched at several sizes. Faces in profile count only where there is none
    from the front; whom `rivals` leaves out does not count.

    Args:
        image: `(H, W, 3)` uint8 RGB, or `(H, W)` grey.
        detector: asked first; the cascades only look for what is too small for it.

    Returns:
        boxes in pixels of `image`, largest first.
    """
    if detector is not None and (seen := detector(image)):
        return rivals(seen)
    found: list[Face] = []
    for scale in _scales(image, _PHOTO_SIDES):
        for face in _at_scale(image, scale, None):
            if not any(_same(face, other) for other in found):
                found.append(face)
    found = [face for face in found if face.frontal] or found
    return rivals(sorted(found, key=lambda face: -face.h))


def rivals(faces: Sequence[Face]) -> list[Face]:
    """Those of a picture's faces that can be the speaker's.

    A face counts only if it has at least half the height of the largest, and does not lie on
    the neck, chest or shoulders of a larger one: there collars, prints and hands look like one.

    Args:
        faces: largest first.
    """
    kept: list[Face] = []
    for face in faces:
        if face.h < _COMPARABLE * faces[0].h:
            continue
        if not any(_on_body(face, other) for other in kept):
            kept.append(face)
    return kept


def _on_body(face: Face, person: Face) -> bool:
    across = abs(face.centre_x - person.centre_x) / person.w
    down = (face.centre_y - person.centre_y) / person.h
    return -0.5 < down < 3.5 and across < (0.75 if down < 0.75 else 1.0)


def _scales(image: np.ndarray, sides: Sequence[int]) -> list[float]:
    """Factors that bring the long side to each of `sides`; none enlarges but to 320 pixels."""
    longest = max(image.shape[:2])
    largest = max(1.0, 320 / longest)
    scales = [min(side / longest, largest) for side in sides]
    return sorted(set(scales))


def _find_near(image: np.ndarray, near: Face, detector: Detector | None) -> list[Face]:
    height, width = image.shape[:2]
    left, top = max(0, int(near.x - near.w)), max(0, int(near.y - near.h))
    right, bottom = int(near.x + 2 * near.w), int(near.y + 2 * near.h)
    part = image[top : min(bottom, height), left : min(right, width)]
    if min(part.shape[:2], default=0) < _SMALLEST:
        return []
    if detector is not None:
        return [face.scaled(1.0, left, top) for face in detector(part)]
    scale = min(1.0, _NEAR_HEIGHT / near.h)
    found = _at_scale(part, scale, Face(0, 0, near.w * scale, near.h * scale))
    return [face.scaled(1.0, left, top) for face in found]


def _at_scale(image: np.ndarray, scale: float, near: Face | None) -> list[Face]:
    method = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    grey = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=method)
    return sorted((f.scaled(1 / scale) for f in _search(grey, near)), key=lambda face: -face.h)
