"""A region space of synthetic clips with onsets where the motion stops; networks of our own."""

import dataclasses

import numpy as np
import pytest

from angie.evaluation.space import RegionSpace, points
from angie.metrics.autoencoder import MotionAutoencoder, train_autoencoder
from angie.metrics.autoencoder import windows as cut
from angie.motion.clips import MotionClip
from angie.motion.statistics import measure
from data_prep.speaker.people import Hand, People, Pose
from data_prep.speech.features import Speech
from data_prep.speech.synchrony import smooth_minima, steps
from mraa.training.run import Run, RunConfig


def heard(clip: MotionClip) -> MotionClip:
    """The clip with onsets at the beats of its own motion."""
    beats = smooth_minima(steps(points(clip.motion)[:, :2]).mean(1), 25)
    features = {name: clip.speech[name] for name in ("onset", "mfcc")}
    features["onset_times"] = beats.astype(np.float32)
    return dataclasses.replace(clip, speech=Speech.of_features(features, clip.speech.frames))


@pytest.fixture(scope="session")
def space(clips) -> RegionSpace:
    """Eight training clips and four test clips of two speakers."""
    whole = [heard(clip) for clip in clips]
    return RegionSpace("abc", whole[:8], whole[8:], measure(whole[:8]))


@pytest.fixture(scope="session")
def model(space, tmp_path_factory) -> MotionAutoencoder:
    """An auto-encoder trained for a moment."""
    scale = space.scale
    clips = [scale.standard(c.motion.vector().numpy(), c.speaker) for c in space.train]
    run = Run(tmp_path_factory.mktemp("fgd"), "fgd", steps=20, config=RunConfig("cpu"))
    return train_autoencoder(cut(clips), run)


RIGHT, LEFT = (60.0, 200.0), (190.0, 200.0)
"""Middles of the hands, wherever they are."""


class SeesWhite(People):
    """Sees a body with its hands at fixed places, and a hand where the picture is white."""

    def __init__(self, *_):
        pass

    def forget(self):
        pass

    def pose(self, image):
        return self.pose_at(image, (np.array([256.0, 256.0]), 500.0, 0.0))

    def pose_at(self, image, body):
        points = np.zeros((33, 2))
        points[[0, 12, 11]] = (128, 70), (90, 130), (166, 130)
        points[[16, 20, 18]] = points[[15, 19, 17]] = RIGHT
        points[[15, 19, 17]] = LEFT
        return Pose(2 * points + 0.5, np.ones(33), body)

    def hand(self, image, square):
        x, y = np.rint(square[0]).astype(int)
        return Hand(np.tile(square[0], (21, 1)), float(image[y, x].mean() / 255))

    def face(self, image):
        return None


@pytest.fixture(scope="session")
def sees_white():
    """Takes the place of the networks that see people."""
    return SeesWhite
