"""MediaPipe's face, pose and hand networks through OpenCV, to find and to judge hands.

They are no part of the project: the folder that holds them is an argument of the scripts. They lie
in the wheel of `mediapipe` 0.10.21 (Apache License 2.0); OpenCV alone runs them.
"""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from data_prep.errors import BadInput

WRISTS, INDEXES, PINKIES = (16, 15), (20, 19), (18, 17)
"""Points of the pose: of the right hand, then of the left one."""

FILES = (
    "face_detection_short_range.tflite",
    "pose_landmark_full.tflite",
    "hand_landmark_full.tflite",
)

Square = tuple[np.ndarray, float, float]
"""Centre (x, y), side in pixels and angle in degrees of a part of a picture."""


@dataclass(frozen=True)
class Pose:
    """A body as the pose network sees it."""

    points: np.ndarray
    """(33, 2) in pixels."""
    visible: np.ndarray
    """(33,) in [0, 1]."""


class People:
    """The three networks; the body is followed from frame to frame.

    Args:
        folder: where the networks' files are.

    Raises:
        BadInput: a file is missing.
    """

    def __init__(self, folder: Path | None) -> None:
        for name in FILES:
            if folder is None or not (Path(folder) / name).is_file():
                raise BadInput(f"{folder}: has no {name}; unpack them from mediapipe's wheel")
        self.nets = [cv2.dnn.readNetFromTFLite(str(Path(str(folder)) / name)) for name in FILES]
        self.score = self.nets[2].getUnconnectedOutLayersNames().index("Identity_1")
        self.anchors = _anchors()
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
            self.body = (np.array([face[0], face[1] + 2.4 * face[2]]), 6.8 * face[2], 0.0)
            passes = 3
        for _ in range(passes):
            matrix = _cut(*self.body, 256)
            crop = cv2.warpAffine(image, matrix, (256, 256), flags=cv2.INTER_AREA) / 255
            rows = next(o for o in self._run(1, crop) if o.size == 195).reshape(39, 5)
            back = cv2.invertAffineTransform(matrix)
            points, visible = rows[:, :2] @ back[:, :2].T + back[:, 2], _sigmoid(rows[:, 3])
            along = points[34] - points[33]
            side = 2.5 * float(np.linalg.norm(along))
            if not 20 < side < 6 * max(image.shape):
                break
            angle = float(np.degrees(np.arctan2(along[1], along[0])) + 90)
            self.body = (points[33], side, angle)
        return Pose(points[:33], visible[:33])

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
            if pose.visible[WRISTS[side]] <= 0.5:
                squares.append(None)
                continue
            along = self.hand_centre(pose.points, side) - wrist
            angle = float(np.degrees(np.arctan2(along[1], along[0])) + 90)
            width = float(np.linalg.norm(pose.points[11] - pose.points[12])) * 0.85
            squares.append((self.hand_centre(pose.points, side), width, angle))
        return squares

    def hand_score(self, image: np.ndarray, square: Square) -> float:
        """How surely a part of a picture shows a hand, in [0, 1]."""
        matrix = _cut(*square, 224)
        crop = cv2.warpAffine(image, matrix, (224, 224), borderMode=cv2.BORDER_REPLICATE) / 255
        return float(self._run(2, crop)[self.score].ravel()[0])

    def face(self, image: np.ndarray) -> tuple[float, float, float] | None:
        """Centre (x, y) and width in pixels of the likeliest face."""
        side = max(image.shape[:2])
        square = np.zeros((side, side, 3), np.uint8)
        square[: image.shape[0], : image.shape[1]] = image
        small = cv2.resize(square, (128, 128), interpolation=cv2.INTER_AREA)
        out = self._run(0, small.astype(np.float32) / 127.5 - 1)
        boxes = next(o for o in out if o.size == 896 * 16).reshape(896, 16)
        scores = _sigmoid(next(o for o in out if o.size == 896).ravel())
        best = int(scores.argmax())
        if scores[best] < 0.5:
            return None
        x, y = boxes[best, :2] / 128 + self.anchors[best]
        return float(x * side), float(y * side), float(boxes[best, 2] / 128 * side)

    def _run(self, number: int, image: np.ndarray) -> list[np.ndarray]:
        net = self.nets[number]
        net.setInput(np.ascontiguousarray(image.astype(np.float32).transpose(2, 0, 1)[None]))
        return list(net.forward(net.getUnconnectedOutLayersNames()))


def _sigmoid(x: np.ndarray) -> np.ndarray:
    return 1 / (1 + np.exp(-np.clip(x, -60, 60)))


def _anchors() -> np.ndarray:
    """Places (896, 2) in [0, 1] that the face network's boxes are relative to."""
    rows = []
    for stride, count in ((8, 2), (16, 6)):
        cells = 128 // stride
        y, x = np.mgrid[:cells, :cells]
        places = np.stack([x.ravel() + 0.5, y.ravel() + 0.5], -1) / cells
        rows.append(np.repeat(places, count, axis=0))
    return np.concatenate(rows).astype(np.float32)


def _cut(centre: np.ndarray, side: float, angle: float, size: int) -> np.ndarray:
    """The map (2, 3) of a turned square of a picture to `size` pixels."""
    matrix = cv2.getRotationMatrix2D((float(centre[0]), float(centre[1])), angle, size / side)
    matrix[:, 2] += size / 2 - np.array(centre)
    return matrix
