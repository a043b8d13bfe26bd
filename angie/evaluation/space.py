"""The clips of a dataset as points that move: what generators are scored in.

The points are the regions of one estimator, or joints. Regions of two estimators have nothing in
common, nor have regions and joints, so scores can be compared only within a space.

The phantom's true joints in the frames of a dataset, and reading joints from regions.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from angie.bundle import Bundle
from angie.evaluation.definitions import PIXEL
from angie.metrics.autoencoder import MotionScale
from angie.metrics.beats import usual_steps
from angie.motion.clips import MotionClip, read_clips
from angie.motion.statistics import MotionStatistics, measure
from data_prep.arrays import read_arrays
from data_prep.dataset import Clip, Dataset
from data_prep.errors import BadInput
from data_prep.phantom.skeleton import JOINTS
from data_prep.rates import FPS, IMAGE_SIZE
from mraa.extract import extract_dataset
from mraa.motion import Motion


@dataclass(frozen=True)
class RegionSpace:
    """Clips of a dataset as one region estimator sees them, or as joints.

    Attributes:
        estimator: hash of the renderer whose estimator measured the motion; of the dataset, where
            its joints are the motion.
        train: training clips, at least one.
        test: test clips, at least one.
        statistics: of the training clips.
        kind: "regions" or "joints".
    """

    estimator: str
    train: list[MotionClip]
    test: list[MotionClip]
    statistics: MotionStatistics
    kind: str = "regions"

    @property
    def pixel(self) -> float | None:
        """Pixels of one unit of the motion; None where joints have a unit of their own."""
        return PIXEL if self.kind == "regions" else None

    @cached_property
    def _steps(self) -> NDArray:
        return usual_steps([points(clip.motion) for clip in self.train])

    @property
    def active(self) -> NDArray:
        """(K,) bool, the points that gesture; points that never move are left out."""
        return self.statistics.active.numpy() & (self._steps > 0)

    @property
    def usual(self) -> NDArray:
        """(A,) mean step of the active points in the training clips, for beat consistency."""
        return self._steps[self.active]

    @property
    def scale(self) -> MotionScale:
        """How motion vectors are standardised for FGD: displacement over its deviation, s_y."""
        statistics = self.statistics
        return MotionScale(
            statistics.speakers, statistics.rest.numpy(), statistics.pose_scale.numpy()
        )


def points(motion: Motion) -> NDArray:
    """Region centres (T, K, 2) float64 of motion, in [-1, 1]; or joints, in their own unit."""
    return motion.shift.double().numpy()


def open_space(dataset: Dataset, bundle: Bundle, scratch: Path, device: str) -> RegionSpace:
    """Read the motion that the bundle's training left, or measure it.

    `bundle`: whose region estimator counts. `scratch`: folder for motion that has to be measured;
    created if need be.

    Raises:
        BadInput: no training or no test clips.
    """
    for split in ("train", "test"):
        if not dataset.clips(split):
            raise BadInput(f"{dataset.path}: has no {split} clips; prepare more videos")
    renderer = bundle.hash_of("renderer")
    identity = bundle.motion_identity(dataset.digest)
    folder = bundle.train / "motion"
    try:
        train = read_clips(dataset, folder, "train", identity)
        test = read_clips(dataset, folder, "test", identity)
    except BadInput:  # of another dataset, or thrown away
        extract_dataset(dataset, bundle.renderer().estimator.to(device), scratch, identity)
        train = read_clips(dataset, scratch, "train", identity)
        test = read_clips(dataset, scratch, "test", identity)
    return RegionSpace(renderer, train, test, measure(train))


def onsets_within(clip: MotionClip, frames: int) -> NDArray:
    """Onsets (n,) of a clip's sound in its first `frames` frames, seconds."""
    times = np.asarray(clip.speech["onset_times"], np.float64)
    return times[times < frames / FPS]


RIDGE = 1e-3
"""Weight of the squared coefficients for each frame, inputs standardised."""


@dataclass(frozen=True)
class FrameTruth:
    """Where things are in one frame, (x, y) in pixels of the frame."""

    centres: NDArray
    """(3, 2) right hand, left hand, nose."""
    wrists: NDArray
    """(2, 2) right, left."""
    tips: NDArray | None
    """(2, 5, 2) finger tips of the right and the left hand."""


@dataclass(frozen=True)
class Truth:
    """What is known of a clip that was drawn, (x, y) in pixels of its frames."""

    joints: NDArray
    """(T, 12, 2), as `data_prep.phantom.skeleton.JOINTS`."""
    fingers: NDArray | None
    """(T, 2, 5, 2) finger tips; the phantom's are not known."""

    def at(self, number: int) -> FrameTruth:
        """The truth of one frame."""
        right, left, nose = (JOINTS.index(name) for name in ("right_hand", "left_hand", "nose"))
        points, tips = self.joints[number], None if self.fingers is None else self.fingers[number]
        return FrameTruth(points[[right, left, nose]], points[[right - 1, left - 1]], tips)


def true_joints(dataset: Dataset, raw: Path) -> dict[str, NDArray]:
    """Joints (T, J, 2) of clips in pixels of their frames, by clip id; see `truths`."""
    return {name: truth.joints for name, truth in truths(dataset, raw).items()}


def truths(dataset: Dataset, raw: Path) -> dict[str, Truth]:
    """What is known of clips, by clip id.

    Args:
        dataset: prepared from videos of drawn people.
        raw: folder with a `.truth.npz` beside each video, as `angie phantom` writes it.

    Raises:
        BadInput: no clip of the dataset has its truth there.
    """
    files = {path.name: path for path in sorted(Path(raw).rglob("*.truth.npz"))}
    sources = {source["name"]: source for source in dataset.manifest["sources"]}
    found = {}
    for clip in dataset.clips():
        source = sources.get(clip.source)
        name = "" if source is None else f"{Path(source['file']).stem}.truth.npz"
        if source is not None and name in files:
            truth = _truth_of(files[name], clip, source)
            if truth is not None:
                found[clip.id] = truth
    if not found:
        raise BadInput(f"{raw}: holds the truth (*.truth.npz) of no clip of {dataset.path}")
    return found


def _truth_of(path: Path, clip: Clip, source: dict[str, Any]) -> Truth | None:
    """The truth of one clip in pixels of its frames; None where it does not reach."""
    try:
        arrays = read_arrays(path, ("joints", "fingers"))
        joints = arrays["joints"].astype(np.float64)
        fingers = arrays["fingers"].astype(np.float64) if "fingers" in arrays else None
        if joints.ndim != 3 or joints.shape[2] != 2:
            raise ValueError(f"joints {joints.shape}")
        if fingers is not None and fingers.shape != (len(joints), 2, 5, 2):
            raise ValueError(f"fingers {fingers.shape}")
    except (KeyError, ValueError) as error:
        raise BadInput(f"{path}: no truth of the phantom speaker ({error})") from error
    first = round(clip.start * FPS)
    crops = [s["crop"] for s in source["spans"] if s["first"] <= first < s["stop"]]
    crop = (crops[0] if crops else None) or source["crop"]
    if crop is None or len(joints) < first + clip.n_frames:
        return None

    def placed(points: NDArray) -> NDArray:
        part = points[first : first + clip.n_frames]
        return (part - [crop["x"], crop["y"]]) * (IMAGE_SIZE / crop["size"])

    return Truth(placed(joints), None if fingers is None else placed(fingers))


JointReader = Callable[[NDArray], NDArray]
"""Gives joints (T, J, 2) in pixels of motion vectors (T, C)."""


def fit_reader(vectors: NDArray, joints: NDArray) -> JointReader:
    """Fit a ridge regression of joints (n, J, 2) on motion vectors (n, C) of training frames."""
    from sklearn.linear_model import Ridge  # slow to import
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    model = make_pipeline(StandardScaler(), Ridge(RIDGE * len(vectors)))
    model.fit(vectors, joints.reshape(len(joints), -1))
    return lambda vectors: model.predict(vectors).reshape(len(vectors), -1, 2)
