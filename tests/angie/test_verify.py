"""A video says what it was made of, and is told from others by drawing it again."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image

from angie import verify as module
from angie.bundle import PHOTO
from angie.provenance import SOURCE_TYPE, hash_of, manifest, read_origin
from angie.verify import verify
from data_prep.errors import BadInput
from data_prep.media.audio import write_wav
from data_prep.media.video import VideoWriter


def equal(video, motion):
    return torch.equal(video.motion.vector(), motion)


@pytest.fixture(scope="module")
def made(short_video, tmp_path_factory):
    return short_video.save(tmp_path_factory.mktemp("made") / "out.mp4", consent="a drawing")


def test_the_manifest_speaks_as_c2pa_does(short_video):
    told = manifest(short_video.record, "a drawing")
    assert told["claim_generator_info"]["name"] == "angie" and told["alg"] == "sha256"
    labels = [one["label"] for one in told["assertions"]]
    assert labels == ["c2pa.actions.v2", *2 * ["c2pa.ingredient.v3"], "angie.consent"]
    (action,) = told["assertions"][0]["data"]["actions"]
    assert (action["action"], action["digitalSourceType"]) == ("c2pa.created", SOURCE_TYPE)


def test_what_a_video_says_can_be_read(made):
    told = str(read_origin(made))
    assert "not a real recording" in told and "seed=3" in told and "consent     a drawing" in told
    assert hash_of(PHOTO)[1] in told


def test_videos_without_origin_are_told(tmp_path):
    with VideoWriter(tmp_path / "plain.mp4", (64, 64), description='{"claim": 1}') as video:
        video.write(np.zeros((64, 64, 3), np.uint8))
    (tmp_path / "no.gif").write_bytes(b"GIF89a")
    for name in ("plain.mp4", "no.gif"):
        with pytest.raises(BadInput, match="says nothing of its origin"):
            read_origin(tmp_path / name)
    with pytest.raises(BadInput, match="no such file"):
        read_origin(tmp_path / "none.gif")


def test_the_same_video_is_verified(made, shipped, blip):
    verdict = verify(made, shipped, PHOTO, blip)
    assert verdict.same and verdict.psnr == float("inf") and "every frame is equal" in str(verdict)


def test_another_photo_sound_or_seed_is_not(
    made, short_video, shipped, blip, tmp_path, monkeypatch
):
    Image.open(PHOTO).resize((400, 400)).save(tmp_path / "other.png")
    silence = tmp_path / "other.wav"
    write_wav(silence, np.zeros(8000), 16_000)
    for photo, sound, words in (
        (tmp_path / "other.png", blip, "not the photo"), (PHOTO, silence, "not the sound"),
    ):  # fmt: skip
        verdict = verify(made, shipped, photo, sound)
        assert not verdict.same and words in verdict.reason
    with pytest.raises(BadInput, match="--audio"):
        verify(made, shipped, PHOTO)
    origin = read_origin(made)
    motion = short_video.motion.vector()
    other = next(n for n in range(4, 30) if not equal(shipped(PHOTO, blip, seed=n), motion))
    changed = replace(origin, settings={**origin.settings, "seed": other})
    monkeypatch.setattr(module, "read_origin", lambda path: changed)
    verdict = verify(made, shipped, PHOTO, blip)
    assert not verdict.same and verdict.psnr < module.NEAR


def test_another_picture_or_sound_under_the_same_record_is_not(
    made, shipped, blip, short_video, tmp_path
):
    record = short_video.record
    silent = replace(short_video, sound=None, record=record).save(tmp_path / "silent.mp4")
    assert verify(silent, shipped, PHOTO, blip).reason == "its sound is another"

    def darker():
        return (batch // 2 for batch in short_video)

    dark = replace(short_video, draw=darker).save(tmp_path / "dark.mp4")
    assert not verify(dark, shipped, PHOTO, blip).same
    shutil.copy(made, tmp_path / "copy.mp4")
    assert verify(tmp_path / "copy.mp4", shipped, PHOTO, blip).same
