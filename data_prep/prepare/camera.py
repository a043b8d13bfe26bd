"""Whether and how the camera moves: the background's motion, apart from the people."""

from collections.abc import Sequence

import cv2
import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from data_prep.speaker.faces import Face

SIDE = 320
"""Long side in pixels of the pictures in which the background is followed."""

_POINTS = 100
_FEWEST = 12
"""Points of the background below which nothing is said of the camera."""

_MAJORITY = 0.5
"""Part of the points that must move as one."""

_KEPT = 0.7
"""Part of the points that once moved as one below which a new reference is taken."""

_FAR = 0.12
"""Way, in long sides, after which a new reference is taken, for what has come into view."""

_CLOSE = 0.7
"""Pixels within which a point moves with the others."""

_REACH, _WIDEST = 3.2, 0.35
"""Half width, in face widths, of the column around a face, from the hair down, in which no
background is sought; and the most of the picture's width that the columns take to each side of
a head. From the chin down they are as wide as that."""

_STILL, _STILL_SHARE, _STILL_LEAD = 0.5, 0.3, 0.6
"""Pixels, part of the points, and part of those that move as one, by which points that stay
where they are mean a still camera: a person may have more points than the background."""

_SPREAD = 0.8
"""Width and height over which points must lie, in those of the picture, added up; the points of
a limb lie closer together."""

_PROBES = np.array([[0.15, 0.15], [0.85, 0.15], [0.15, 0.85], [0.85, 0.85]])
"""Places in the picture, in widths and heights, at which motion is measured."""

_OTHER = 8.0
"""Mean grey levels by which a picture in which nothing is found again shows another scene."""

_HELD = 3
"""Pictures through which a reference must have been followed for its loss to mean something."""

_BLIND = 5
"""Pictures after which points are sought again where there were none."""

SHORT_WINDOW, SHORT_WAY = 25, 0.012
"""Frames, and the way in long sides that a still camera may stray within so many."""

LONG_WINDOW, LONG_WAY, SLOWEST = 250, 0.02, 0.003
"""The same over ten seconds, for frames in whose short window it strays by `SLOWEST` at least."""

FURTHEST = 0.3
"""Way in long sides beyond which a moving camera is not undone."""


class CameraTracker:
    """Follows points of the background from a reference picture, anew whenever it is lost.

    Each picture is compared with the reference itself, so that errors do not add up and a slow
    zoom is seen. What most points do together is the camera's motion; a hand is not most.

    Attributes:
        lost: whether the last picture had nothing in common with those before it.
    """

    def __init__(self) -> None:
        self.lost = True
        self._scale = 1.0
        self._previous: np.ndarray | None = None
        self._reference: np.ndarray | None = None
        self._points: np.ndarray = np.zeros((0, 1, 2), np.float32)
        self._seen: np.ndarray = self._points
        self._held = 0
        self._blind = 0
        self._most = 0.0
        self._base = np.eye(3)
        self._current = np.eye(3)
        self._matrices: list[np.ndarray] = []
        self._breaks: list[int] = []

    def add(self, grey: np.ndarray, faces: Sequence[Face], frames: int = 1) -> None:
        """Look at the next picture.

        Args:
            grey: `(H, W)` uint8, of one size for the whole video.
            faces: last known, in its pixels; there no background is sought.
            frames: for how many frames at 25 fps it is shown.
        """
        self._scale = min(1.0, SIDE / max(grey.shape))
        small = cv2.resize(grey, None, fx=self._scale, fy=self._scale, interpolation=cv2.INTER_AREA)
        people = [face.scaled(self._scale) for face in faces]
        followed = self._follow(small, people)
        self.lost = not followed and self._differs(small)
        if self.lost:
            if self._held >= _HELD or not self._matrices:
                self._breaks.append(len(self._matrices))
                self._current = np.eye(3)
        if followed:
            self._held += 1
        else:
            self._held = 0
            self._refer(small, people)
        self._previous = small
        self._matrices.extend([self._current] * frames)

    def hold(self, frames: int = 1) -> None:
        """Take the camera for still in the next picture, as it is not known where people are."""
        self.lost = False
        self._held = 0
        self._matrices.extend([self._current] * frames)

    def avoid(self, faces: Sequence[Face]) -> None:
        """Take the points anew in the last picture, off these faces: it is known where they are."""
        if self._previous is not None:
            self._refer(self._previous, [face.scaled(self._scale) for face in faces])

    def path(self, scale: float = 1.0) -> "CameraPath":
        """The motion over the whole video.

        Args:
            scale: of the picture in whose pixels it is wanted, in parts of those that were seen.
        """
        scale /= self._scale
        matrices = np.array(self._matrices).reshape(-1, 3, 3)
        matrices[:, :2, 2] *= scale
        height, width = (1, 1) if self._previous is None else self._previous.shape
        return CameraPath(matrices, self._breaks, width * scale, height * scale)

    def _differs(self, small: np.ndarray) -> bool:
        """Whether a picture shows another scene than the last, and not only a hand elsewhere."""
        if self._previous is None:
            return True
        return float(cv2.absdiff(small, self._previous).mean()) > _OTHER

    def _refer(self, small: np.ndarray, people: Sequence[Face]) -> None:
        self._reference, self._base = small, self._current
        free = np.full(small.shape, 255, np.uint8)
        widest = _WIDEST * small.shape[1] / max(len(people), 1)
        for face in people:
            # Beside the head of a close-up there is background; beside its body there is none.
            for top, most in ((face.y - 0.6 * face.h, widest), (face.y + face.h, np.inf)):
                half = min(_REACH * face.w, most)
                left, right = face.centre_x - half, face.centre_x + half
                free[max(0, int(top)) :, max(0, int(left)) : max(0, int(right))] = 0
        found = cv2.goodFeaturesToTrack(small, _POINTS, 0.02, 7, mask=free)
        self._points = np.zeros((0, 1, 2), np.float32)
        if found is not None:
            # Corners too weak to be followed are not found again even where they are.
            seen, good = _flow(small, small, np.asarray(found, np.float32))
            if good.sum() >= _FEWEST and _spread(seen[good], small) >= _SPREAD:
                self._points = seen[good]
        self._seen = self._points
        self._most = 0.0

    def _follow(self, small: np.ndarray, people: Sequence[Face]) -> bool:
        """Set the current matrix by the new picture; whether anything of it was known."""
        if self._reference is None or self._previous is None:
            return False
        if len(self._points) < _FEWEST:
            # Nothing to hold on to: a still camera, until the picture shows something.
            self._held = 0
            other = self._differs(small)
            self._blind = 0 if other else self._blind + 1
            if self._blind % _BLIND == 0:
                self._refer(small, people)
            return not other
        matrix, kept = self._match(small)
        if matrix is None:
            self._refer(self._previous, people)
            if len(self._points) < _FEWEST:
                return False
            matrix, kept = self._match(small)
            if matrix is None:
                return False
        self._current = matrix @ self._base
        way = np.abs(_ways(matrix[None], small.shape[1], small.shape[0])).max()
        self._most = max(self._most, kept)
        if kept < _KEPT * self._most or way > _FAR:
            self._refer(small, people)
        return True

    def _match(self, small: np.ndarray) -> tuple[np.ndarray | None, float]:
        """Matrix from the reference to a picture, and the part of the points that agree."""
        assert self._reference is not None
        seen, good = _flow(self._reference, small, self._points, self._seen)
        if good.sum() < _FEWEST:
            return None, 0.0
        affine, agree = cv2.estimateAffinePartial2D(
            self._points[good], seen[good], ransacReprojThreshold=_CLOSE
        )
        share = 0.0 if affine is None else float(agree.sum()) / len(self._points)
        stay = np.abs(seen - self._points)[good].max(axis=(1, 2)) < _STILL
        still = float(stay.sum()) / len(self._points)
        if still >= max(_STILL_SHARE, _STILL_LEAD * share):
            self._seen = self._points
            return np.eye(3), max(share, still)
        if share * len(self._points) < max(_FEWEST * 0.75, _MAJORITY * good.sum()):
            return None, 0.0
        if _spread(seen[good][agree.ravel() == 1], small) < _SPREAD:
            return None, 0.0
        self._seen = cv2.transform(self._points, affine).astype(np.float32)
        return np.vstack([affine, [0, 0, 1]]), share


def _flow(
    before: np.ndarray, after: np.ndarray, points: np.ndarray, guess: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Where points `(N, 1, 2)` of a picture are in another, and which of them were found."""
    seen, found, _ = cv2.calcOpticalFlowPyrLK(
        before,
        after,
        points,
        points.copy() if guess is None else guess.copy(),
        winSize=(15, 15),
        maxLevel=3,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        minEigThreshold=1e-3,
    )
    return np.asarray(seen, np.float32), np.asarray(found).ravel() == 1


def _spread(points: np.ndarray, picture: np.ndarray) -> float:
    """Width and height over which points `(N, 1, 2)` lie, in those of the picture, added up."""
    if not len(points):
        return 0.0
    height, width = picture.shape
    return float((np.ptp(points[:, 0], axis=0) / (width, height)).sum())


def _ways(matrices: np.ndarray, width: float, height: float) -> np.ndarray:
    """Way of the probes from where they were, `(T, 4, 2)` in long sides."""
    probes = _PROBES * (width, height)
    moved = probes @ matrices[:, :2, :2].transpose(0, 2, 1) + matrices[:, None, :2, 2]
    return (moved - probes) / max(width, height)


class CameraPath:
    """How the camera moved over a video.

    Attributes:
        matrices: `(T, 3, 3)` from the pixels of the picture at the last break to those of each
            frame, as similarities.
        breaks: frames that have nothing in common with the one before.
    """

    def __init__(
        self, matrices: np.ndarray, breaks: Sequence[int], width: float, height: float
    ) -> None:
        self.matrices = matrices
        self.breaks = list(breaks)
        self._size = (width, height)

    def travel(self, first: int, stop: int) -> float:
        """The furthest that a part of the picture moves between any two frames, long sides."""
        ways = _ways(self.matrices[first:stop], *self._size)
        return float((ways.max(axis=0) - ways.min(axis=0)).max(initial=0.0))

    def moving(self, first: int, stop: int) -> np.ndarray:
        """In which frames of a shot the camera moves, `(stop - first,)` bool."""
        ways = _ways(self.matrices[first:stop], *self._size).reshape(stop - first, 8)
        steady = ways.copy()
        if len(ways) > 2:
            steady[1:-1] = np.median([ways[:-2], ways[1:-1], ways[2:]], axis=0)
        short = _range_within(steady, SHORT_WINDOW)
        slow = (_range_within(steady, LONG_WINDOW) > LONG_WAY) & (short > SLOWEST)
        moves = (short > SHORT_WAY) | slow
        for frame in self.breaks:
            if first < frame < stop:
                moves[max(0, frame - first - SHORT_WINDOW // 2) : frame - first + 1] = True
        return moves

    def between(self, reference: int, frame: int) -> np.ndarray:
        """The similarity `(3, 3)` from one frame's pixels to another's; no break between."""
        return self.matrices[frame] @ np.linalg.inv(self.matrices[reference])


def _range_within(ways: np.ndarray, window: int) -> np.ndarray:
    """Largest minus smallest value in a window around each row, the most of all columns."""
    if not len(ways):
        return np.zeros(0)
    high = maximum_filter1d(ways, window, axis=0, mode="nearest")
    low = minimum_filter1d(ways, window, axis=0, mode="nearest")
    return np.asarray((high - low).max(axis=1))
