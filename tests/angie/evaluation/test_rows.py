"""The rows that always stand there, and where their motion comes from."""

import dataclasses

import numpy as np
import pytest
import torch

from angie.evaluation import rows
from angie.evaluation.space import points


def test_ground_truth_is_what_was_recorded(space):
    (run,) = rows.ground_truth(space).runs
    for clip, performance in zip(space.test, run, strict=True):
        assert performance.motion is not None and performance.clip == clip.name
        assert torch.equal(performance.motion.vector(), clip.motion.vector())
        assert torch.equal(performance.truth.vector(), clip.motion.vector())
        assert np.array_equal(performance.onsets, clip.speech["onset_times"].astype(np.float64))


def test_the_motionless_speaker_holds_the_first_pose(space):
    (run,) = rows.motionless(space).runs
    for clip, performance in zip(space.test, run, strict=True):
        assert performance.motion.frames == clip.motion.frames
        assert torch.equal(performance.motion.vector().unique(dim=0), clip.motion.vector()[:1])


def test_mismatched_motion_is_of_the_same_speaker_and_of_another_clip(space):
    row = rows.mismatched(space, seeds=[0, 1, 2])
    assert len(row.runs) == 3
    own = {clip.speaker: [] for clip in space.test}
    for clip in space.test:
        own[clip.speaker].append(clip.motion.vector())
    for run in row.runs:
        for clip, performance in zip(space.test, run, strict=True):
            made = performance.motion.vector()
            others = [m for m in own[clip.speaker] if not torch.equal(m, clip.motion.vector())]
            assert any(torch.equal(made, m) for m in others)
    again = rows.mismatched(space, seeds=[2])
    assert torch.equal(again.runs[0][0].motion.vector(), row.runs[2][0].motion.vector())


def test_a_speaker_with_one_test_clip_gets_motion_from_training(space):
    one = dataclasses.replace(space, test=space.test[:1])
    (performance,) = rows.mismatched(one, seeds=[0]).runs[0]
    mine = [c for c in space.train if c.speaker == space.test[0].speaker]
    assert any(torch.equal(performance.motion.vector(), c.motion.vector()) for c in mine)


def test_sound_beyond_shorter_motion_is_cut(space):
    clip = space.test[0]
    performance = rows.perform(clip, clip.motion[:100])
    assert performance.motion.frames == performance.truth.frames == 100
    assert (performance.onsets < 4).all()
    assert len(performance.onsets) < len(clip.speech["onset_times"])


def test_nearest_audio_finds_the_clip_that_has_the_same_sound(space):
    twin = dataclasses.replace(space.test[0], name="twin")
    with_twin = dataclasses.replace(space, train=[*space.train, twin])
    found = rows.nearest_audio(with_twin).runs[0][0].motion.vector()
    # pieces begin at multiples of 88, which are candidates; the last one does as well
    true = twin.motion.vector()
    assert torch.allclose(found, true[:1] + true - true.mean(0), atol=1e-4)
    other = rows.nearest_audio(space).runs[0][0].motion
    assert other.frames == twin.motion.frames
    assert not torch.allclose(other.vector(), found, atol=1e-3)


def test_nearest_audio_joins_pieces_without_a_jump(space):
    made = points(rows.nearest_audio(space).runs[0][0].motion)
    real = np.concatenate([np.abs(np.diff(points(c.motion), axis=0)) for c in space.train])
    seams = np.abs(np.diff(made, axis=0))[86:98]
    assert seams.max() < 4 * real.max()


def test_short_training_clips_serve_in_more_pieces(space):
    short = [dataclasses.replace(c, motion=c.motion[:40]) for c in space.train]
    row = rows.nearest_audio(dataclasses.replace(space, train=short))
    assert row.runs[0][0].motion.frames == space.test[0].motion.frames
    assert torch.isfinite(row.runs[0][0].motion.vector()).all()


def test_an_unknown_start_is_refused(space):
    with pytest.raises(ValueError, match="truth, pose"):
        rows.generated(space, None, None, [0], start="zero")
