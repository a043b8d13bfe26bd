"""What a stage of training is given: clips to learn from and to choose by, windows, artefacts."""

import dataclasses
from pathlib import Path

import pytest
import torch

from angie.generators.base import resample
from angie.generators.stages import StageContext
from data_prep.errors import BadInput
from mraa.motion import Motion
from mraa.training.run import RunConfig


@pytest.fixture
def context(clips, statistics, tmp_path) -> StageContext:
    """A stage with twelve training clips and no clip of the split "val"."""
    return StageContext(
        stage="tokens",
        settings=None,
        bundle=None,
        statistics=statistics,
        read_clips={"train": clips, "val": []}.__getitem__,
        sound=lambda name: pytest.fail("no other grids are asked for"),
        folder=tmp_path / "train",
        seed=0,
        run=RunConfig(device="cpu", identity="one"),
        resume=False,
        place=Path("data"),
    )


def test_every_tenth_clip_is_kept_where_there_is_no_validation_split(context, clips):
    train, kept = context.clips()
    assert kept == [clips[9]] and train == [*clips[:9], *clips[10:]]
    context.read_clips = {"train": clips[:4], "val": clips[4:6]}.__getitem__
    assert context.clips() == (clips[:4], clips[4:6])
    with pytest.raises(BadInput, match="data: no training clip has 251 frames"):
        context.clips(251)
    windows, held_out = context.windows(stride=8)
    assert (windows.stride, held_out.stride, len(held_out.clips)) == (8, 32, 2)


def test_an_artefact_is_made_once_and_anew_for_another_origin(context):
    made = []

    def make():
        made.append(context.run.identity)
        return {"tokens": torch.arange(3)}

    for _ in range(2):
        assert torch.equal(context.cached("tokens", make)["tokens"], torch.arange(3))
    context.run = dataclasses.replace(context.run, identity="other")
    assert context.cached("tokens", make)["tokens"].dtype == torch.int64
    assert made == ["one", "other"]


def test_motion_at_another_rate_of_a_hand_worked_case():
    motion = Motion.of_points(torch.tensor([0.0, 3.0, 6.0])[:, None, None].expand(3, 1, 2))
    assert resample(motion, 10, 30).shift[:, 0, 0].tolist() == [0, 1, 2, 3, 4, 5, 6]
    assert resample(motion, 10, 5).shift[:, 0, 0].tolist() == [0, 6]
    assert resample(motion, 10, 10, frames=5).shift[:, 0, 0].tolist() == [0, 3, 6, 6, 6]
