"""A photo that moves as a driving video does."""

import av
import numpy as np
import pytest
import torch
from PIL import Image

from angie.bundle import BUNDLE, Bundle
from angie.config import preset
from angie.drive import Driving, drive
from angie.pipeline import GesturePipeline
from angie.source import View
from data_prep.errors import BadInput
from data_prep.media.audio import read_sound, write_wav
from data_prep.media.video import VideoWriter, read_frames
from data_prep.phantom.make import still
from data_prep.speaker.crop import Crop
from mraa.renderer import Renderer, make_avd

LENGTH, PAN = 14, 24
PICTURE = still(1, seed=5)
SIDE = min(PICTURE.shape[:2]) - 2 * PAN
SQUARE = Crop(0, 0, SIDE)


def view(moved):
    """The picture with everything moved to the right by `moved` pixels, SIDE pixels a side."""
    first = (PICTURE.shape[1] - SIDE) // 2 - moved
    return np.ascontiguousarray(PICTURE[:SIDE, first : first + SIDE])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drive")
    Image.fromarray(view(0)).save(folder / "photo.png")
    click = np.zeros(12_000, np.float32)
    click[4000:4400] = 0.5
    write_wav(folder / "own.wav", click)
    write_wav(folder / "long.wav", np.roll(np.tile(click, 3), 4000))
    for name, sound in (("talking.mp4", folder / "own.wav"), ("silent.mp4", None)):
        with VideoWriter(folder / name, (SIDE, SIDE), sound=sound) as video:
            for i in range(LENGTH):
                video.write(view(round(PAN * i / (LENGTH - 1))))
    return folder


def make(folder, output, bundle=BUNDLE, video="talking.mp4", *, force=False, **options):
    driving = {name: options.pop(name) for name in ("mode", "sound") if name in options}
    for name in ("drive_crop", "drive_person"):
        driving[name[6:]] = options.pop(name, SQUARE if name == "drive_crop" else None)
    pipe = GesturePipeline(Bundle.open(bundle), precision="fp32")
    view = View(**{"crop": SQUARE, **options})
    made = drive(pipe, folder / "photo.png", folder / video, Driving(**driving), view)
    made.save(output, force=force)
    return made


@pytest.fixture(scope="module")
def driven(folder):
    result = make(folder, folder / "driven.mp4")
    return result, np.stack(list(read_frames(folder / "driven.mp4")))


def test_the_photo_moves_as_the_driver(driven):
    _, frames = driven
    photo, last = (
        np.asarray(Image.fromarray(view(moved)).resize((256, 256), Image.Resampling.BOX), float)
        for moved in (0, PAN)
    )
    inner = slice(64, 192)  # the borders show what the photo has not

    def apart(a, b):
        return float(np.abs(a[inner, inner] - b[inner, inner]).mean())

    assert apart(frames[0], photo) < 0.4 * apart(photo, last)
    assert apart(frames[-1], last) < 0.75 * apart(photo, last)


def first_loud(path):
    heard = np.abs(read_sound(path))
    return float(np.argmax(heard > 0.2) / 16_000)


def test_the_drivers_sound_is_kept(driven, folder):
    (result, frames), path = driven, folder / "driven.mp4"
    assert result.frames == len(frames) == LENGTH and result.note == ""
    assert result.seconds == LENGTH / 25
    with av.open(str(path)) as file:
        picture, sound = file.streams.video[0], file.streams.audio[0]
        assert picture.duration * picture.time_base == sound.duration * sound.time_base
        assert "AI-generated" in file.metadata["comment"]
    assert first_loud(path) == pytest.approx(0.25, abs=0.02)


@pytest.fixture(scope="module")
def rough(folder):
    """An untrained bundle with both networks, whose regions have axes."""
    sizes = preset("tiny")
    renderer = Renderer(sizes.renderer)
    torch.manual_seed(0)
    bundle = Bundle.create(folder / "rough", sizes)
    bundle.add("renderer", renderer.state_dict(), {})
    bundle.add("avd", make_avd(sizes.renderer).state_dict(), {})
    return bundle.folder


def test_a_recording_replaces_it(folder, rough, tmp_path):
    path = tmp_path / "a.mp4"
    result = make(folder, path, rough, sound=folder / "long.wav")
    assert first_loud(path) == pytest.approx(0.5, abs=0.02)
    assert "long.wav is longer than the driving video" in result.note
    with av.open(str(path)) as file:
        sound = file.streams.audio[0]
        assert float(sound.duration * sound.time_base) == LENGTH / 25


def test_a_silent_driver_gives_a_silent_video(folder, rough, tmp_path):
    path = tmp_path / "a.mp4"
    result = make(folder, path, rough, "silent.mp4", size="512")
    assert result.seconds == 0 and result.width_height == (512, 512)
    with av.open(str(path)) as file:
        assert not file.streams.audio and file.streams.video[0].frames == LENGTH


def test_the_network_is_the_default_where_there_is_one(folder, rough, tmp_path):
    given = {"video": "silent.mp4", "bundle": rough}
    frames = {}
    for mode in (None, "avd", "standard"):
        path = tmp_path / f"{mode}.mp4"
        make(folder, path, mode=mode, **given)
        frames[mode] = np.stack(list(read_frames(path)))
    assert np.array_equal(frames[None], frames["avd"])
    assert not np.array_equal(frames["avd"], frames["standard"])


def test_bad_input_leaves_nothing(folder, rough, tmp_path):
    output = tmp_path / "a.mp4"
    for options, words in (
        ({"mode": "fast"}, "--mode fast"),
        ({"mode": "avd"}, "has no avd yet; run angie train --stage avd"),
        ({"drive_person": "first"}, "--drive-person first"),
        ({"drive_crop": Crop(9000, 0, 10)}, "--drive-crop: the square lies outside"),
        ({"video": "own.wav"}, "no moving picture"),
        ({"track_axes": True}, "--track-axes"),
        ({"sound": folder / "photo.png"}, "photo.png"),
    ):
        with pytest.raises(BadInput, match=words):
            make(folder, output, **options)
    with pytest.raises(BadInput, match="would replace the input"):
        make(folder, folder / "talking.mp4", force=True)
    assert list(tmp_path.iterdir()) == [] and (folder / "talking.mp4").exists()
