"""Bodies, hands and faces in pictures of people, as networks of the user's files see them."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from data_prep.speaker.networks import FACE, HAND, POSE, detect_faces, load_network

SHOULDERS, ELBOWS, WRISTS = (12, 11), (14, 13), (16, 15)
INDEXES, PINKIES = (20, 19), (18, 17)
EARS, MOUTH, NOSE = (8, 7), (10, 9), 0
"""Points of the pose: the right one, then the left one, as the person has them."""

TIPS = (4, 8, 12, 16, 20)
"""Points of a hand: tips of thumb, index, middle, ring and little finger."""

LOWER = 0.13
"""Way in heights of a face's box from its middle down to the nose."""

SEEN = 0.5
"""Score from which a hand, and visibility from which a point counts as seen."""

Square = tuple[np.ndarray, float, float]
"""Centre (x, y), side in pixels and angle in degrees of a part of a picture."""


@dataclass(frozen=True)
class Pose:
    """A body as the pose network sees it."""

    points: np.ndarray
    """(33, 2) in pixels."""
    visible: np.ndarray
    """(33,) in [0, 1]."""
    body: Square
    """Where it was looked for."""


@dataclass(frozen=True)
class Hand:
    """A hand as the hand network sees it."""

    points: np.ndarray
    """(21, 2) in pixels."""
    score: float
    """How surely there is a hand, in [0, 1]."""


class People:
    """The three networks; the body is followed from frame to frame.

    Args:
        folder: where the networks' files are.

    Raises:
        BadInput: a file is missing, or is another network.
    """

    def __init__(self, folder: Path) -> None:
        self.faces, self.poses, self.hands = (load_network(folder, k) for k in (FACE, POSE, HAND))
        self.body: Square | None = None

    def forget(self) -> None:
        """Another video begins."""
        self.body = None

    def pose(self, image: np.ndarray) -> Pose | None:
        """The body in a picture (H, W, 3) uint8 RGB; None where nobody is found."""
        passes = 1
        if self.body is None:
            face = self.face(image)
            if face is None:
                return None
            self.body = (np.array([face[0], face[1] + 2.25 * face[2]]), 6.5 * face[2], 0.0)
            passes = 3
        for _ in range(passes):
            pose, points = self._look(image, self.body)
            along = points[34] - points[33]
            side = 2.5 * float(np.linalg.norm(along))
            if not 20 < side < 6 * max(image.shape):
                break
            angle = float(np.degrees(np.arctan2(along[1], along[0])) + 90)
            self.body = (points[33], side, angle)
        return pose

    def pose_at(self, image: np.ndarray, body: Square) -> Pose:
        """The body where it was seen in another picture of the same size."""
        return self._look(image, body)[0]

    def _look(self, image: np.ndarray, body: Square) -> tuple[Pose, np.ndarray]:
        """The body in a square, and all 39 points (x, y), the last ones for the next square."""
        matrix = _cut(*body, 256)
        crop = cv2.warpAffine(image, matrix, (256, 256), flags=cv2.INTER_AREA) / 255
        rows = self.poses(crop)[0].reshape(39, 5)
        points = _moved(rows[:, :2], cv2.invertAffineTransform(matrix))
        return Pose(points[:33], _sigmoid(rows[:33, 3]), body), points

    def hand_centre(self, points: np.ndarray, side: int) -> np.ndarray:
        """Middle (x, y) of the right (0) or left (1) hand of a pose."""
        wrist = points[WRISTS[side]]
        knuckles = (points[INDEXES[side]] + points[PINKIES[side]]) / 2
        return wrist + (knuckles - wrist) * 1.2

    def hand_squares(self, pose: Pose) -> list[Square | None]:
        """Where the right and the left hand are; None for one whose wrist is not seen."""
        squares: list[Square | None] = []
        for side in (0, 1):
            wrist = pose.points[WRISTS[side]]
            if pose.visible[WRISTS[side]] <= SEEN:
                squares.append(None)
                continue
            along = self.hand_centre(pose.points, side) - wrist
            angle = float(np.degrees(np.arctan2(along[1], along[0])) + 90)
            width = float(np.linalg.norm(np.subtract(*pose.points[list(SHOULDERS)]))) * 0.85
            squares.append((self.hand_centre(pose.points, side), width, angle))
        return squares

    def hand(self, image: np.ndarray, square: Square) -> Hand:
        """The hand in a square of a picture."""
        matrix = _cut(*square, 224)
        crop = cv2.warpAffine(image, matrix, (224, 224), borderMode=cv2.BORDER_REPLICATE) / 255
        points, score, _ = self.hands(crop)
        back = cv2.invertAffineTransform(matrix)
        return Hand(_moved(points.reshape(21, 3)[:, :2], back), float(score[0, 0]))

    def face(self, image: np.ndarray) -> tuple[float, float, float] | None:
        """Middle (x, y) and width in pixels of the largest face, from the brows to the chin."""
        found = detect_faces(self.faces, image)
        if not found:
            return None
        face = found[0]
        return face.centre_x, face.centre_y + LOWER * face.h, face.w


def _moved(points: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    return np.asarray(points @ matrix[:, :2].T + matrix[:, 2])


def _sigmoid(x: np.ndarray) -> np.ndarray:
    return 1 / (1 + np.exp(-np.clip(x, -60, 60)))


def _cut(centre: np.ndarray, side: float, angle: float, size: int) -> np.ndarray:
    """The map (2, 3) of a turned square of a picture to `size` pixels."""
    middle = (float(centre[0]), float(centre[1]))
    matrix = np.asarray(cv2.getRotationMatrix2D(middle, angle, size / side), np.float64)
    matrix[:, 2] += size / 2 - np.array(centre)
    return matrix
