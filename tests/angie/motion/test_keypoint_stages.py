"""What the stages of a generator are given of a folder of joints."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from lightning_fabric import Fabric

from angie.bundle import Bundle
from angie.config import override
from angie.generators.angie.family import FAMILY
from angie.generators.stages import StageContext
from angie.motion.keypoints import KeypointDataset
from angie.training import Trainer
from data_prep.errors import BadInput
from mraa.training.run import RunConfig


def context_of(model, data, cache, stage, **changes):
    """What a stage of angie is given, with some settings of its training of the GPT changed."""
    bundle = Bundle.open(model)
    bundle.preset = override(bundle.preset, {"train_gpt": changes} if changes else {})
    trainer = Trainer(
        KeypointDataset(data, cache), bundle, 0, RunConfig(), False, Fabric(accelerator="cpu")
    )
    return trainer.context(FAMILY, FAMILY.stage(stage))


def test_other_grids_are_another_training_of_the_gpt_alone(model, data, tmp_path):
    stages = ("vq", "gpt", "refiner")
    before, after = (
        [context_of(model, data, tmp_path, stage, **changes).run.identity for stage in stages]
        for changes in ({}, {"grids": 4})
    )
    assert [a == b for a, b in zip(before, after, strict=True)] == [True, False, True]


def test_the_gpt_and_what_stands_in_its_place_learn_on_the_grids_asked_for(
    model, data, tmp_path, monkeypatch
):
    asked = []

    def windows(self, stride, grids=1, sound="onset"):
        asked.append((stride, grids))
        raise InterruptedError

    monkeypatch.setattr(StageContext, "windows", windows)
    for quant, stage in (("full", "gpt"), ("full", "vq"), ("no_quant", "vq")):
        context = context_of(model, data, tmp_path, stage, grids=4, stride=16)
        settings = context.settings
        context.settings = replace(settings, vq=replace(settings.vq, quant=quant))
        with pytest.raises(InterruptedError):
            FAMILY.stage(stage).train(context)
    assert asked == [(16, 4), (settings.train_vq.stride, 1), (16, 4)]


def test_the_recording_of_a_clip_is_the_one_of_its_name(data, tmp_path):
    folder = tmp_path / "data"
    shutil.copytree(data, folder)
    audio = folder / "audio"
    shutil.copy(audio / "c1.wav", audio / "c0.b.wav")  # of another clip, "c0.b"
    (audio / "c0.TextGrid").touch()
    joints = KeypointDataset(folder, tmp_path / "cache")
    assert np.array_equal(joints.sound("c0"), KeypointDataset(data, tmp_path).sound("c0"))
    before = joints.digest
    shutil.copy(audio / "c1.wav", audio / "c0.wav")
    assert KeypointDataset(folder, tmp_path / "cache").digest != before
    (audio / "c0.mp3").touch()
    with pytest.raises(BadInput, match="c0.mp3 and c0.wav; leave one"):
        joints.sound("c0")


def test_weights_are_chosen_by_the_validation_split_where_there_is_one(model, data, tmp_path):
    def names(folder, grids=1):
        context = context_of(model, folder, tmp_path / "cache", "gpt")
        return [[clip.name for clip in windows.clips] for windows in context.windows(32, grids)]

    learnt, kept = names(data, grids=2)
    assert learnt == [*(f"c{n}" for n in range(9)), *(f"c{n}+4" for n in range(9))]
    assert kept == ["c9"]
    learnt, kept = names(data)
    assert (learnt, kept) == ([f"c{n}" for n in range(9)], ["c9"])  # every tenth
    shutil.copytree(data, tmp_path / "data")
    index = tmp_path / "data" / "clips.csv"
    index.write_text(index.read_text().replace("c3,ada,train", "c3,ada,val"))
    learnt, kept = names(tmp_path / "data")
    assert kept == ["c3"] and len(learnt) == 9 and "c9" in learnt and "c3" not in learnt
    index.write_text(index.read_text().replace("c5,ada,train", "c5,zoe,val"))
    assert names(tmp_path / "data")[1] == ["c3"]  # zoe has no style that was learnt
