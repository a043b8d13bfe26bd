"""Networks that see faces, poses and hands, from files that the user gives; OpenCV runs them.

They are MediaPipe's, as they lie in its wheel (Apache License 2.0): `face_detection_short_range`,
`pose_landmark_full` and `hand_landmark_full`, each a `.tflite` file. None ships with the project.
"""

import functools
import threading
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from data_prep.errors import BadInput
from data_prep.media.container import check_file
from data_prep.speaker.faces import Detector, Face


@dataclass(frozen=True)
class Kind:
    """A network that is known.

    Attributes:
        file: name of its file.
        side: pixels of the square picture that it takes.
        outputs: what it gives, by name, with the number of values of each.
    """

    file: str
    side: int
    outputs: dict[str, int]


FACE = Kind(
    "face_detection_short_range.tflite", 128, {"regressors": 896 * 16, "classificators": 896}
)
"""BlazeFace: RGB in [-1, 1]; offsets of boxes and six points from 896 anchors, and logits."""

POSE = Kind("pose_landmark_full.tflite", 256, {"Identity": 195, "Identity_1": 1})
"""RGB in [0, 1], a crop around the body; 39 points (x and y in pixels of the crop, depth, logits
of visibility and presence), the last six of them helpers; score that there is a body."""

HAND = Kind("hand_landmark_full.tflite", 224, {"Identity": 63, "Identity_1": 1, "Identity_2": 1})
"""RGB in [0, 1], a crop around a hand; 21 points (x and y in pixels of the crop, depth), score
that there is a hand, and score that it is the right one."""


class Network:
    """A network of a file, as `load_network` gives it; threads may share it."""

    def __init__(self, path: Path, kind: Kind) -> None:
        """Load the file and run it once.

        Raises:
            BadInput: missing, damaged, or another network than its name says.
        """
        self.kind = kind
        self._lock = threading.Lock()  # a network keeps its input in itself
        check_file(path)
        try:
            self._network = cv2.dnn.readNetFromTFLite(str(path))
            sizes = [values.size for values in self(np.zeros((kind.side, kind.side, 3)))]
        except (cv2.error, SystemError, ValueError) as error:
            what = "not a network that OpenCV can read"
            raise BadInput(f"{path}: {what}; take it from the wheel mediapipe 0.10.21") from error
        if sizes != list(kind.outputs.values()):
            raise BadInput(f"{path}: another network than {kind.file}; take it from the wheel")

    def __call__(self, picture: np.ndarray) -> list[np.ndarray]:
        """Run it.

        Args:
            picture: `(side, side, 3)`, RGB in the range of the kind.

        Returns:
            float32 arrays in the order of `kind.outputs`.
        """
        blob = np.ascontiguousarray(picture.transpose(2, 0, 1)[None], np.float32)
        with self._lock:
            self._network.setInput(blob)
            return [np.array(values) for values in self._network.forward(list(self.kind.outputs))]


@functools.cache
def _loaded(path: Path, kind_file: str) -> Network:
    return Network(path, {kind.file: kind for kind in (FACE, POSE, HAND)}[kind_file])


def load_network(folder: Path, kind: Kind) -> Network:
    """A network of a folder; each is loaded once in a process.

    Args:
        folder: that holds the file `kind.file`.
        kind: `FACE`, `POSE` or `HAND`.

    Raises:
        BadInput: no such folder or file, or a file that is not this network.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise BadInput(f"--models {folder}: no such folder; name the one that holds {kind.file}")
    path = folder / kind.file
    if not path.exists():
        raise BadInput(f"--models {folder}: has no {kind.file}; take it from mediapipe 0.10.21")
    return _loaded(path.resolve(), kind.file)


_SURE = 0.5
"""Score from which there is a face."""

_HEIGHT, _UP = 1.05, 0.13
"""Height of the cascades' boxes in those of BlazeFace, and way up to their centre in heights of
theirs: medians over 17 photos. So the crop around a person is the same whoever finds the face."""

_OVERLAP = 0.3
"""Part of the union that two boxes share from which they show one face."""


@functools.cache
def _anchors() -> np.ndarray:
    """Centres `(896, 2)` in sides of the picture: two a cell of 8 pixels, six a cell of 16."""
    rows = []
    for stride, count in ((8, 2), (16, 6)):
        places = (np.arange(FACE.side // stride) + 0.5) * stride / FACE.side
        y, x = np.meshgrid(places, places, indexing="ij")
        rows.append(np.repeat(np.stack([x.ravel(), y.ravel()], axis=1), count, axis=0))
    return np.concatenate(rows).astype(np.float32)


def detect_faces(network: Network, image: np.ndarray) -> list[Face]:
    """Faces in a picture by BlazeFace (Bazarevsky et al., 2019).

    It sees faces from about a tenth of the longer side on. Boxes that overlap are averaged by
    their scores, as the paper does.

    Args:
        network: of kind `FACE`.
        image: `(H, W, 3)` uint8 RGB, or `(H, W)` grey.

    Returns:
        boxes in pixels of `image`, from the brows to the chin, largest first.
    """
    if image.ndim == 2:
        image = cv2.cvtColor(image, cv2.COLOR_GRAY2RGB)
    height, width = image.shape[:2]
    longest, side = max(height, width), FACE.side
    size = (max(round(width * side / longest), 1), max(round(height * side / longest), 1))
    small = np.zeros((side, side, 3), np.uint8)
    left, top = (side - size[0]) // 2, (side - size[1]) // 2
    small[top : top + size[1], left : left + size[0]] = cv2.resize(
        image, size, interpolation=cv2.INTER_AREA if longest > side else cv2.INTER_LINEAR
    )
    offsets, logits = network(small.astype(np.float32) / 127.5 - 1)
    scores = 1 / (1 + np.exp(-np.clip(logits.ravel(), -50, 50)))
    sure = scores >= _SURE
    values = offsets.reshape(-1, 16)[sure] / side
    places = _anchors()[sure]
    centres, sizes = values[:, :2] + places, values[:, 2:4]
    points = values[:, 4:].reshape(-1, 6, 2) + places[:, None]
    faces = []
    for group in _groups(centres, sizes, scores[sure]):
        weight = scores[sure][group] / scores[sure][group].sum()
        x, y = (weight @ centres[group] * side - (left, top)).tolist()
        w, h = (weight @ sizes[group] * side * _HEIGHT).tolist()
        y -= _UP * h
        eyes_and_nose = np.tensordot(weight, points[group][:, :3], 1)
        face = Face(x - w / 2, y - h / 2, w, h, _is_frontal(eyes_and_nose))
        faces.append(face.scaled(longest / side))
    return sorted(faces, key=lambda face: -face.h)


def face_detector(folder: Path | None) -> Detector | None:
    """The detector of a folder of networks, or None without one.

    Raises:
        BadInput: as `load_network`.
    """
    return None if folder is None else functools.partial(detect_faces, load_network(folder, FACE))


def _groups(centres: np.ndarray, sizes: np.ndarray, scores: np.ndarray) -> list[np.ndarray]:
    """Numbers of the boxes `(N, 2)` that show one face each, the surest face first."""
    low, high, area = centres - sizes / 2, centres + sizes / 2, sizes.prod(axis=1)
    left = np.argsort(-scores, kind="stable")
    groups = []
    while len(left):
        best = left[0]
        shared = np.minimum(high[left], high[best]) - np.maximum(low[left], low[best])
        common = shared.clip(0).prod(axis=1)
        same = common > _OVERLAP * (area[left] + area[best] - common)
        same[0] = True
        groups.append(left[same])
        left = left[~same]
    return groups


def _is_frontal(points: np.ndarray) -> bool:
    """Whether the nose lies between the eyes; `(3, 2)`: right eye, left eye, nose."""
    right, left, nose = points
    across = left - right
    place = (nose - right) @ across / max(float(across @ across), 1e-9)
    return bool(0.0 < place < 1.0)
