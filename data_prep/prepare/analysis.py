"""The first of two passes over a video: shots, camera, faces and bars, from small pictures.

Black bars around a picture: letterboxes and pillars.
"""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from data_prep.media.video import VideoInfo, read_grey
from data_prep.prepare.camera import CameraPath, CameraTracker
from data_prep.prepare.shots import Shot, ShotDetector
from data_prep.speaker.faces import Detector
from data_prep.speaker.tracking import FaceFollower, Sighting

_SIDE = 480

_DARKEST = 40
"""Grey level that a bar has at most."""

_NOISE = 8
"""Grey levels by which a bar's pixels may stray over time and place."""

_EDGE = 0.4
"""Part of a bar's length along which the picture beside it must be lit at some time."""

_MOST = 0.4
"""Part of the picture's height or width that one bar has at most."""

_STEP = 5
"""Frames of which one is looked at; bars are there in all of them."""

_SECTION = 750
"""Frames after which bars are looked for anew."""


@dataclass(frozen=True)
class View:
    """The part of a video's picture that shows something, in pixels.

    Attributes:
        left: first column.
        top: first row.
        right: one past the last column.
        bottom: one past the last row.
    """

    left: int
    top: int
    right: int
    bottom: int

    @property
    def width(self) -> int:
        """Columns."""
        return self.right - self.left

    @property
    def height(self) -> int:
        """Rows."""
        return self.bottom - self.top

    def of(self, picture: np.ndarray) -> np.ndarray:
        """That part of a picture `(H, W, ...)`, without copying."""
        return picture[self.top : self.bottom, self.left : self.right]


@dataclass(frozen=True)
class _Section:
    first: int
    stop: int
    inner: tuple[float, float, float, float] | None


class BarDetector:
    """Keeps the brightest value of every pixel over a section of a video.

    A bar is dark, even and never changes, and the picture begins at it with a straight edge;
    so the dark stage around a lit speaker is none.
    """

    def __init__(self) -> None:
        self._brightest: np.ndarray | None = None
        self._sections: list[_Section] = []
        self._first = self._count = self._next = 0

    def add(self, grey: np.ndarray, frames: int = 1, cut: bool = False) -> None:
        """Look at the next picture.

        Args:
            grey: `(H, W)` uint8, of one size for the whole video.
            frames: for how many frames at 25 fps it is shown.
            cut: whether a new shot begins with it.
        """
        if cut or self._count - self._first >= _SECTION:
            self._finish()
        if cut or self._count >= self._next:
            self._next = self._count + _STEP
            scale = min(1.0, _SIDE / max(grey.shape))
            small = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
            if self._brightest is None:
                self._brightest = small
            else:
                np.maximum(self._brightest, small, out=self._brightest)
        self._count += frames

    def _finish(self) -> None:
        if self._brightest is not None:
            inner = inner_part(self._brightest)
            self._sections.append(_Section(self._first, self._count, inner))
        self._brightest, self._first = None, self._count

    def view(self, first: int, stop: int, width: int, height: int) -> View:
        """What shows something in frames `[first, stop)` of a picture of that size.

        One pixel of the small pictures is left out at each bar, where the edge may be mixed.
        """
        self._finish()
        seen = [
            section.inner
            for section in self._sections
            if section.inner is not None and section.first < stop and section.stop > first
        ]
        if not seen:
            return View(0, 0, width, height)
        left, top = (min(inner[i] for inner in seen) for i in (0, 1))
        right, bottom = (max(inner[i] for inner in seen) for i in (2, 3))
        return View(
            int(np.ceil(left * width)),
            int(np.ceil(top * height)),
            int(np.floor(right * width)),
            int(np.floor(bottom * height)),
        )


def inner_part(brightest: np.ndarray) -> tuple[float, float, float, float] | None:
    """What lies between the bars of a picture.

    Args:
        brightest: `(H, W)` uint8, the brightest value of each pixel over time.

    Returns:
        left, top, right and bottom in widths and heights of the picture; None where all is dark.
    """
    if brightest.max() <= _DARKEST + _NOISE:
        return None
    height, width = brightest.shape
    top = _bar(brightest)
    bottom = height - _bar(brightest[::-1])
    between = brightest[top:bottom]
    left = _bar(between.T)
    right = width - _bar(between.T[::-1])
    # Pillars may hide where a letterbox is lit, so rows are judged again between them.
    between = brightest[:, left:right]
    top, bottom = _bar(between), height - _bar(between[::-1])
    return (
        (left + (left > 0)) / width,
        (top + (top > 0)) / height,
        (right - (right < width)) / width,
        (bottom - (bottom < height)) / height,
    )


def _bar(rows: np.ndarray) -> int:
    """Number of rows that a bar takes from the first on."""
    level = float(np.median(rows[0]))
    if level > _DARKEST:
        return 0
    lit = rows > level + _NOISE
    # Single pixels may stray: a logo's edge, or noise.
    dark = lit.mean(axis=1) < 0.02
    count = int(np.argmin(dark)) if not dark.all() else 0
    if not count or count > _MOST * len(rows):
        return 0
    beside = lit[count : count + 3].any(axis=0).mean()
    return count if beside >= _EDGE else 0


LONGEST = 720
"""Long side in pixels of the pictures that are looked at."""


@dataclass(frozen=True)
class Analysis:
    """What was seen of a video; frames are counted at 25 fps from its first frame.

    Attributes:
        frames: of the whole video.
        shots: all frames as shots, and fades between them.
        camera: its motion, in pixels of the original picture.
        sightings: faces in pixels of the original picture.
        bars: where the picture has black bars.
    """

    frames: int
    shots: list[Shot]
    camera: CameraPath
    sightings: list[Sighting]
    bars: BarDetector

    def view(self, shot: Shot, info: VideoInfo) -> View:
        """The picture between black bars in a shot."""
        return self.bars.view(shot.first, shot.stop, info.width, info.height)


def analyse(
    path: Path, info: VideoInfo, faces: bool = True, detector: Detector | None = None
) -> Analysis:
    """Go through a video once.

    Args:
        path: the video.
        info: as `probe` returns it.
        faces: whether to look for faces.
        detector: of faces, asked before the cascades.

    Raises:
        BadInput: as `read_grey`.
    """
    shots, camera, bars = ShotDetector(), CameraTracker(), BarDetector()
    follower = FaceFollower(detector)
    count = 0
    scale = 1.0
    for grey, frames in read_grey(path, LONGEST):
        scale = max(info.height, info.width) / max(grey.shape)
        shots.add(grey, frames)
        if follower.astray:
            camera.hold(frames)
        else:
            camera.add(grey, follower.places, frames)
        people = len(follower.places)
        if faces:
            follower.add(grey, count, new=camera.lost)
        if camera.lost or len(follower.places) > people:
            camera.avoid(follower.places)
        bars.add(grey, frames, cut=camera.lost)
        count += frames
    sightings = [
        Sighting(s.frame, tuple(face.scaled(scale) for face in s.faces)) for s in follower.sightings
    ]
    return Analysis(count, shots.shots(), camera.path(scale), sightings, bars)
