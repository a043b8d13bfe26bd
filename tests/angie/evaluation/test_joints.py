"""The phantom's joints in the frames of a dataset, and reading them from regions."""

import numpy as np
import pytest

from angie.evaluation.space import fit_reader, true_joints, truths
from data_prep.errors import BadInput


def test_a_reader_learns_a_linear_relation():
    rng = np.random.default_rng(0)
    vectors = rng.normal(size=(400, 6)) * [1, 2, 3, 0.1, 1, 1] + 5
    weights = rng.normal(size=(6, 4))
    joints = (vectors @ weights + 100).reshape(400, 2, 2)
    reader = fit_reader(vectors[:300], joints[:300])
    assert np.abs(reader(vectors[300:]) - joints[300:]).max() < 0.1


def test_joints_of_the_phantom_lie_on_the_frames(phantom_videos, dataset):
    joints = true_joints(dataset, phantom_videos)
    assert set(joints) == {clip.id for clip in dataset.clips()}
    for clip in dataset.clips():
        own = joints[clip.id]
        assert own.shape == (clip.n_frames, 12, 2)
        crown, chin = own[:, 0], own[:, 2]
        assert (crown[:, 1] < chin[:, 1]).all()  # y is down
        assert (own[:, :4] > 0).all() and (own[:, :4] < 256).all()  # the head is in the picture


def test_finger_tips_are_read_where_they_are_known(phantom_videos, dataset, tmp_path):
    for path in phantom_videos.rglob("*.truth.npz"):
        with np.load(path) as file:
            joints = file["joints"]
        tips = np.repeat(joints[:, [7, 11], None], 5, axis=2)  # all in the middle of the hand
        np.savez(tmp_path / path.name, joints=joints, fingers=tips)
    for name, truth in truths(dataset, tmp_path).items():
        assert np.array_equal(truth.fingers[:, :, 2], truth.joints[:, [7, 11]]), name
        first = truth.at(0)
        assert np.array_equal(first.centres[:2], first.tips[:, 0])
        assert np.array_equal(first.wrists, truth.joints[0, [6, 10]])


def test_a_folder_without_truth_is_refused(dataset, tmp_path):
    with pytest.raises(BadInput, match="truth"):
        true_joints(dataset, tmp_path)
