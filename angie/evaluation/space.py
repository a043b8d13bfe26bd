"""The clips of a dataset as points that move: what generators are scored in.

The points are the regions of one estimator, or joints. Regions of two estimators have nothing in
common, nor have regions and joints, so scores can be compared only within a space.
"""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from angie.bundle import Bundle
from angie.evaluation.definitions import PIXEL
from angie.metrics.autoencoder import MotionScale
from angie.metrics.beats import usual_steps
from angie.motion.clips import MotionClip, read_clips
from angie.motion.statistics import MotionStatistics, measure
from data_prep.dataset import Dataset
from data_prep.errors import BadInput
from data_prep.rates import FPS
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
    identity = f"{renderer}-{dataset.digest}"
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
