"""The style of a joint model: another motion around the same pose."""

import itertools

import numpy as np
import pytest
import torch
from PIL import Image

from angie.cli import main
from angie.motion.amplitude import scale_displacement
from angie.pipeline import GesturePipeline
from angie.source import View
from angie.style import styles
from data_prep.errors import BadInput
from data_prep.media.audio import write_wav
from data_prep.phantom.make import recording, still
from data_prep.speaker.crop import Crop, cut_out
from mraa.draw import source_pose
from mraa.motion import Motion, write_motion
from mraa.renderer import from_pixels

CROP = Crop(150, 20, 301)


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """A photo and a recording of two seconds."""
    folder = tmp_path_factory.mktemp("inputs")
    Image.fromarray(still(0, seed=5)).save(folder / "photo.png")
    talk = recording(0, seconds=3.0, seed=5)
    write_wav(folder / "speech.wav", talk.samples[: 2 * talk.rate], talk.rate)
    return folder


@pytest.fixture(scope="module")
def pose(inputs, joint_bundle):
    """The photo's pose."""
    cut = cut_out(np.asarray(Image.open(inputs / "photo.png")), CROP)
    return source_pose(joint_bundle.renderer(), from_pixels(torch.from_numpy(cut)[None]))


@pytest.fixture(scope="module")
def start(pose, tmp_path_factory):
    """A file of motion that begins with the photo's pose."""
    path = tmp_path_factory.mktemp("start") / "start.npz"
    write_motion(path, pose)
    return path


def call(monkeypatch, capsys, *arguments):
    """Exit status, standard output and standard error of `angie ARGUMENTS`."""
    monkeypatch.setattr("sys.argv", ["angie", *map(str, arguments)])
    status = 0
    try:
        main()
    except SystemExit as leave:
        status = leave.code or 0
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def test_a_style_changes_the_video_but_not_its_first_frame(inputs, joint_bundle):
    pipe = GesturePipeline(joint_bundle)
    photo, speech, view = inputs / "photo.png", inputs / "speech.wav", View(crop=CROP)
    videos = [
        np.concatenate(list(pipe(photo, speech, style=name, view=view))).astype(int)
        for name in (None, *styles(joint_bundle))
    ]
    for one, other in itertools.combinations(videos, 2):
        changed = np.abs(one - other).mean(axis=(1, 2, 3))  # of 255
        assert changed[0] == 0 and changed[1:].max() > 0.1


def test_the_command_names_a_style(
    inputs, joint_bundle, start, pose, tmp_path, monkeypatch, capsys
):
    made = {}
    for name in (None, *styles(joint_bundle)):
        path = tmp_path / f"{name}.npz"
        line = ["gestures", joint_bundle.folder, inputs / "speech.wav", "-o", path]
        line += ["--start", start, *(["--style", name] if name else [])]
        assert call(monkeypatch, capsys, *line)[0] == 0
        with np.load(path) as file:
            made[name] = file["shift"]
        assert np.array_equal(made[name][0], pose.shift[0].numpy())
    anyone, first, second = made.values()
    assert min(np.abs(a - b).max() for a, b in ((anyone, first), (first, second))) > 0.01
    path = tmp_path / "whole.npz"
    line = ["gestures", joint_bundle.folder, inputs / "speech.wav", "-o", path]
    assert call(monkeypatch, capsys, *line, "--speaker", styles(joint_bundle)[1])[0] == 0
    with np.load(path) as file:  # the speaker begins with their own rest pose
        rest = Motion.from_vector(joint_bundle.statistics().rest[1]).shift
        assert np.array_equal(file["shift"][0], rest.numpy())


def test_info_lists_the_styles(bundle, joint_bundle, monkeypatch, capsys):
    names = ", ".join(joint_bundle.statistics().speakers)
    _, text, _ = call(monkeypatch, capsys, "info", joint_bundle.folder)
    assert f"styles      {names} (--style NAME)\n" in text
    _, text, _ = call(monkeypatch, capsys, "info", bundle.folder)
    assert "styles" not in text and f"speakers    {names}\n" in text


@pytest.mark.usefixtures("one_process")
@pytest.mark.parametrize("command", ["animate", "gestures"])
@pytest.mark.parametrize(("joint", "words"), [(True, "known: {names}"), (False, "one style")])
def test_a_style_that_is_not_there_is_one_line(
    inputs, bundle, joint_bundle, tmp_path, monkeypatch, capsys, command, joint, words
):
    names = ", ".join(styles(joint_bundle))
    folder, speech = (joint_bundle if joint else bundle).folder, inputs / "speech.wav"
    if command == "animate":
        line = ["animate", inputs / "photo.png", speech, "--speaker", folder]
        line += ["-o", tmp_path / "out.mp4"]
    else:
        line = ["gestures", folder, speech, "-o", tmp_path / "out.npz"]
    status, out, err = call(monkeypatch, capsys, *line, "--style", "nobody")
    assert status == 2 and out == "" and err.count("\n") == 1
    assert "nobody" in err and words.format(names=names) in err
    assert list(tmp_path.iterdir()) == []


def test_styles_are_not_for_driving_videos(inputs, joint_bundle, tmp_path, monkeypatch, capsys):
    line = ["animate", inputs / "photo.png", "--drive", inputs / "photo.png", "--style", "nobody"]
    line += ["--speaker", joint_bundle.folder, "-o", tmp_path / "out.mp4"]
    status, _, err = call(monkeypatch, capsys, *line)
    assert status == 2 and "--style" in err and err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_hull_scaling_goes_by_the_speaker_of_the_style(joint_bundle):
    statistics = joint_bundle.statistics()
    name = statistics.speakers[1]
    own = Motion.from_vector(statistics.rest_of(name)[None])
    pose = Motion(own.shift * 2, own.cholesky)
    motion = Motion(pose.shift + 0.1, pose.cholesky)
    scaled = scale_displacement(motion, pose, statistics, name)
    torch.testing.assert_close(scaled.shift - pose.shift, torch.full_like(pose.shift, 0.2))
    with pytest.raises(BadInput, match="known: "):
        scale_displacement(motion, pose, statistics, "nobody")
