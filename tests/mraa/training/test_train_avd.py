"""Training of the disentanglement network."""

import numpy as np
import pytest
import torch

from data_prep.errors import BadInput
from mraa.motion import Motion
from mraa.renderer import RendererConfig
from mraa.training.avd import AvdTraining, RegionPairs, recovery, regions_of, stretched, train_avd
from mraa.training.checkpoint import Schedule
from mraa.training.run import RunConfig

CONFIG = RendererConfig(regions=4, avd_id_width=8, avd_pose_width=8)


def training(steps, milestones=()):
    course = Schedule(rate=2e-3, batch=32, epochs=30, milestones=milestones, most_steps=steps)
    return AvdTraining(schedule=course)


@pytest.fixture
def motions():
    """Twelve clips of one body, of whose four regions two swing."""
    random, made = np.random.default_rng(0), []
    for _ in range(12):
        swing = 0.2 * random.uniform(0.5, 1) * np.sin(np.arange(60) * 2 * np.pi / 24)
        shift = np.tile([[-0.5, 0.5], [0.5, 0.5], [0.0, -0.5], [0.0, 0.0]], (60, 1, 1))
        cholesky = np.tile([0.15, 0.02, 0.1], (60, 4, 1))
        shift[:, 0, 1] += swing
        shift[:, 1, 1] -= swing
        cholesky[:, :2, 1] += 0.2 * swing[:, None]
        parts = (x + random.normal(0, 1e-4, x.shape) for x in (shift, cholesky))
        made.append(Motion(*(torch.from_numpy(x).float() for x in parts)))
    return made


def work(folder, motions, steps, resume=False, milestones=()):
    cpu = RunConfig(device="cpu")
    return train_avd(
        folder, motions, CONFIG, training(steps, milestones), seed=1, run_config=cpu, resume=resume
    )


def test_it_puts_a_stretched_body_back(motions, tmp_path):
    avd = work(tmp_path, motions[:9], 60, milestones=(20, 25))
    score = recovery(avd, motions[9:], CONFIG, 0.25)
    assert score.given_shift > 0.03
    assert score.shift < 0.75 * score.given_shift and score.affine < score.given_affine


def test_resumed_training_is_the_uninterrupted_one(motions, tmp_path):
    whole = work(tmp_path / "whole", motions, 6).state_dict()
    work(tmp_path / "parts", motions, 3)
    parts = work(tmp_path / "parts", motions, 6, resume=True).state_dict()
    assert all(torch.equal(whole[name], parts[name]) for name in whole)


def test_pairs_are_two_frames_of_one_clip_in_any_order(motions):
    pairs, random = RegionPairs(motions[:3]), np.random.default_rng(0)
    drawn = [pairs.draw(1, random) for _ in range(50)]
    vectors = motions[1].vector()
    found = [[int((vectors - row).abs().sum(1).argmin()) for row in pair] for pair in drawn]
    assert all(torch.equal(vectors[f], pair) for f, pair in zip(found, drawn, strict=True))
    assert all(a != b for a, b in found)
    assert {a < b for a, b in found} == {True, False}


def test_a_clip_of_one_frame_gives_no_pair(motions):
    assert len(RegionPairs([motions[0][:1], motions[1]])) == 1
    with pytest.raises(BadInput, match="two frames"):
        RegionPairs([motions[0][:1]])


def test_a_stretched_body():
    motion = Motion(torch.tensor([[[0.5, -0.5]]]), torch.tensor([[[0.2, 0.0, 0.1]]]))
    regions = stretched(regions_of(motion.vector(), "chol"), torch.tensor([[1.2, 0.8]]))
    torch.testing.assert_close(regions.shift, torch.tensor([[[0.6, -0.4]]]))
    wanted = torch.diag(torch.tensor([0.24, 0.08]))
    torch.testing.assert_close(regions.affine[0, 0], wanted)
    torch.testing.assert_close(regions.covariance[0, 0], wanted**2)
