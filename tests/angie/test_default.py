"""What ships with the package works, and is what it says."""

import json
import shutil

import numpy as np
import pytest
from PIL import Image

from angie.bundle import BUNDLE, DEFAULT, PHOTO, SPEECH, WORDS, Bundle
from angie.opening import open_or_create
from angie.parts import describe
from angie.pipeline import GesturePipeline
from data_prep.errors import BadInput
from data_prep.media.audio import read_sound, write_wav
from data_prep.media.video import read_frames
from data_prep.phantom.script import TRIGGERS
from data_prep.speaker.crop import find_faces
from data_prep.speech.features import Speech
from data_prep.speech.words import read_words
from mraa.motion import Motion


def test_the_shipped_bundle_is_whole_and_small():
    bundle = Bundle.open(BUNDLE)
    assert bundle.generators == ["angie", "tricon"]
    assert all(bundle.has(part) for name in bundle.generators for part in bundle.needed(name))
    assert bundle.preset.name == "lite"
    sizes = {path: path.stat().st_size for path in DEFAULT.rglob("*") if path.is_file()}
    second = sum(size for path, size in sizes.items() if path.name.startswith("tricon."))
    assert sum(sizes.values()) - second < 20e6 and second < 9e6
    score = bundle.manifest["parts"]["renderer"]["report"]["reconstruction"]
    assert score["psnr"] > score["copy_psnr"] + 1 and score["l1"] < score["copy_l1"]


def test_the_shipped_photo_and_speech_can_be_used():
    photo = np.asarray(Image.open(PHOTO))
    head, *others = find_faces(photo)  # the largest is animated
    assert head.centre_y < photo.shape[0] / 3 and abs(head.centre_x - photo.shape[1] / 2) < 40
    assert all(face.w < 0.75 * head.w for face in others)
    assert 8 < len(read_sound(SPEECH)) / 16_000 < 20


def test_the_shipped_presenter_moves_while_speaking(tmp_path):
    speech = read_sound(SPEECH)[: 3 * 16_000]
    write_wav(tmp_path / "speech.wav", speech)
    path = tmp_path / "out.mp4"
    GesturePipeline.from_pretrained()(PHOTO, tmp_path / "speech.wav").save(path)
    frames = np.stack(list(read_frames(path))).astype(int)
    assert len(frames) == 75
    moved = np.abs(frames - frames[0]).mean(axis=(1, 2, 3))
    assert moved[5:].mean() > 1  # of 255, over the whole picture
    speed = np.abs(np.diff(frames, axis=0)).mean(axis=(1, 2, 3))
    assert speed.max() < 25  # nothing jumps


def test_the_shipped_words_are_said_and_gestured_to():
    words = read_words(WORDS)
    seconds = len(read_sound(SPEECH)) / 16_000
    assert len(words) > 10 and words[-1].end < seconds
    sure = {word.word for word in words} & set(TRIGGERS)
    assert sure  # words that call for a stroke
    pipe = GesturePipeline.from_pretrained(generator="tricon")
    speech = pipe.speech(SPEECH, WORDS)
    start = Motion.from_vector(pipe.statistics.rest[:1])
    said = pipe.generator.generate(speech, start, 200, style="bella")
    unsaid = pipe.generator.generate(Speech(speech.samples), start, 200, style="bella")
    moved = said.shift.diff(dim=0).norm(dim=-1)
    assert (said.shift - unsaid.shift).abs().max() > 0.02
    assert 0.001 < moved.mean() < 0.02 and moved.max() < 0.2  # units of half a picture


def test_motion_of_a_copy_is_trained_on_without_what_its_renderer_began_with(tmp_path):
    folder = tmp_path / "copy"
    shutil.copytree(BUNDLE, folder)
    assert Bundle.open(folder).preset.train_renderer.initial  # weights that are not there
    changes = {"train_vq": {"path_loss": 2.0}}
    bundle = open_or_create(folder, None, changes, None, "vq", resume=False, force=False)
    for made in (bundle, Bundle.open(folder)):
        assert made.settings("angie").train_vq.path_loss == 2.0
    with pytest.raises(BadInput, match="not the weights"):
        open_or_create(folder, None, changes, None, "renderer", resume=False, force=False)


def test_a_generator_that_is_not_installed_does_not_stand_in_the_way_of_others(tmp_path):
    folder = tmp_path / "copy"
    shutil.copytree(BUNDLE, folder)
    manifest = json.loads((folder / "bundle.json").read_text())
    manifest["config"]["generators"]["robot"] = {"width": 3}
    manifest["parts"]["robot.arm"] = {**manifest["parts"]["angie.gpt"], "file": "arm.safetensors"}
    (folder / "bundle.json").write_text(json.dumps(manifest))
    bundle = Bundle.open(folder)
    assert bundle.generators == ["angie", "tricon", "robot"]
    assert bundle.parts[-2:] == ["robot.arm", "avd"]
    assert bundle.generator().random and bundle.chosen() == "angie"
    assert "robot: --generator robot: there is no such generator" in describe(bundle)
    with pytest.raises(BadInput, match="there is no such generator"):
        bundle.generator("robot")
    bundle.write()  # what is not understood is kept
    written = json.loads((folder / "bundle.json").read_text())
    assert written["config"]["generators"] == manifest["config"]["generators"]
    assert written["parts"] == manifest["parts"]


def test_a_part_lies_in_the_folder_of_its_bundle(tmp_path):
    folder = tmp_path / "copy"
    shutil.copytree(BUNDLE, folder)
    manifest = json.loads((folder / "bundle.json").read_text())
    manifest["parts"]["angie.gpt"]["file"] = "../angie.gpt.safetensors"
    (folder / "bundle.json").write_text(json.dumps(manifest))
    with pytest.raises(BadInput, match="angie.gpt is not described as it should be"):
        Bundle.open(folder)
