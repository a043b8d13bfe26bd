"""What a video is written to, and how its motion is asked for, told of, saved and stopped."""

import json

import av
import numpy as np
import pytest
import torch
from PIL import Image

from angie import Cancelled, load_motion
from angie.bundle import PHOTO
from angie.generators.angie.generate import Controls
from angie.motion.ends import faded
from angie.motion.saved import SavedMotion
from angie.preview import curves, write_sheet
from angie.provenance import RECORD, read_origin
from angie.source import View
from data_prep.errors import BadInput
from data_prep.phantom.make import still
from data_prep.speaker.crop import Crop
from mraa.draw import source_pose
from mraa.motion import Motion

FRAMES = 20


def frames_of(video):
    return np.concatenate(list(video))


def test_every_format_has_all_frames_and_its_origin(short_video, tmp_path):
    for name, format in (("a.mp4", None), ("b.webm", None), ("c.gif", None), ("d", "frames")):
        path = short_video.save(tmp_path / name, format=format, consent="it is a drawing")
        origin = read_origin(path)
        assert origin.consent == "it is a drawing" and origin.settings["seed"] == 3
        assert set(origin.hashes) == {"photo", "sound"} and origin.generator == "angie"
    for name, sound in (("a.mp4", "aac"), ("b.webm", "opus")):
        with av.open(str(tmp_path / name)) as file:
            assert sound in file.streams.audio[0].codec_context.name
            assert sum(1 for _ in file.decode(video=0)) == FRAMES
    drawn = frames_of(short_video)
    with Image.open(tmp_path / "c.gif") as file:
        assert file.n_frames == FRAMES and file.info["duration"] == 40
        file.seek(FRAMES - 1)
        shown = np.asarray(file.convert("RGB")).astype(int)
        assert np.abs(shown - drawn[-1]).mean() < 12  # of 256 colours, dithered
    pictures = sorted((tmp_path / "d").glob("*.png"))
    assert [path.name for path in pictures[::19]] == ["000001.png", "000020.png"]
    assert np.array_equal(np.asarray(Image.open(pictures[-1])), drawn[-1])
    assert json.loads((tmp_path / "d" / RECORD).read_text())["alg"] == "sha256"


def test_names_that_are_no_video_are_told(short_video, tmp_path):
    for name, format, words in (
        ("a.avi", None, "let its name end in .mp4"),
        ("a.mp4", "gif", "let its name end in .gif"),
        ("a.mp4", "frames", "leave .mp4 off"),
        ("a.mp4", "avi", "choose from mp4, webm, gif, frames"),
    ):
        with pytest.raises(BadInput, match=words):
            short_video.save(tmp_path / name, format=format)
    with pytest.raises(BadInput, match=r"end in \.npz"):
        short_video.save_motion(tmp_path / "a.npy")
    assert list(tmp_path.iterdir()) == []


def test_progress_is_told_and_may_end_the_work(shipped, blip, short_video, tmp_path):
    steps = []
    shipped(PHOTO, blip, callback=steps.append)
    labels = [step.label for step in steps]
    assert labels[:3] == ["photo", "sound", "gestures"] and steps[-1].done == steps[-1].total
    steps.clear()
    short_video.save(tmp_path / "a.mp4", callback=steps.append)
    assert [steps[0].done, steps[-1].done, steps[-1].total] == [0, FRAMES, FRAMES]
    assert steps[0].picture is None and steps[-1].picture.shape == (256, 256, 3)

    def stop(step):
        if step.done:
            raise Cancelled

    with pytest.raises(Cancelled):
        short_video.save(tmp_path / "b.mp4", callback=stop)
    with pytest.raises(Cancelled):
        shipped(PHOTO, blip, callback=stop)
    assert [path.name for path in tmp_path.iterdir()] == ["a.mp4"]


def test_saved_motion_is_drawn_again(shipped, short_video, blip, tmp_path):
    path = short_video.save_motion(tmp_path / "a.npz")
    again = shipped.render(PHOTO, path, blip)
    assert np.array_equal(frames_of(again), frames_of(short_video)) and again.seconds == 0.8
    other = Image.fromarray(still(1, seed=2))
    moved = shipped.render(other, load_motion(path))
    pose = source_pose(shipped.renderer, moved.subject.picture)
    assert torch.allclose(moved.motion[:1].vector(), pose.vector(), atol=1e-5)
    away, back = moved.motion.shift - pose.shift, short_video.motion.shift - short_video.pose.shift
    scale = away.norm() / back.norm()
    assert torch.allclose(away, scale * back, atol=1e-5) and moved.sound is None
    saved = SavedMotion(short_video.motion, short_video.pose, "0" * 64)
    with pytest.raises(BadInput, match="of another bundle's regions"):
        shipped.render(PHOTO, saved)
    with pytest.raises(BadInput, match="not a motion file"):
        load_motion(PHOTO)


def test_factors_on_another_photo_are_products_of_matrices():
    def factor(l1, l2, l3):
        return Motion(torch.zeros(1, 1, 2), torch.tensor([[[l1, l2, l3]]]))

    def matrix(motion):
        l1, l2, l3 = motion.cholesky[0, 0].tolist()
        return np.array([[l1, 0], [l2, l3]])

    moved, first, source = factor(0.4, 0.3, 0.2), factor(0.2, -0.1, 0.5), factor(0.3, 0.2, 0.1)
    made = SavedMotion(moved, first).on(source)
    wanted = matrix(moved) @ np.linalg.inv(matrix(first)) @ matrix(source)
    np.testing.assert_allclose(matrix(made), wanted, atol=1e-6)


def test_motion_comes_to_rest_at_its_end():
    motion = Motion.of_points(torch.ones(5, 1, 2))
    rest = Motion.of_points(torch.zeros(1, 1, 2))
    made = faded(motion, rest, 2).shift[:, 0, 0]
    assert made.tolist() == [1, 1, 1, 0.5, 0]
    assert faded(motion, rest, 0) is motion
    assert faded(motion, rest, 9).shift[:, 0, 0].tolist()[::4] == [1, 0]


def test_a_low_temperature_is_greedy_and_rest_is_where_the_person_is(shipped, blip):
    greedy = shipped(PHOTO, blip, greedy=True).motion.vector()
    cold = shipped(PHOTO, blip, temperature=1e-4, seed=9).motion.vector()
    assert torch.equal(greedy, cold)
    same = shipped(PHOTO, blip, controls=Controls(temperature=1e-4), seed=2).motion.vector()
    assert torch.equal(greedy, same)
    rested = shipped(PHOTO, blip, start="rest", fade=0.2)
    vector, pose = rested.motion.vector(), rested.pose
    assert torch.equal(vector[0], vector[-1]) and not torch.equal(vector[:1], pose.vector())
    first = rested.motion.shift[0]
    assert torch.allclose(first.mean(0), pose.shift[0].mean(0), atol=1e-5)
    for options, words in (
        ({"temperature": 0}, "--temperature 0"),
        ({"temperature": 1, "greedy": True}, "give one"),
        ({"start": "sofa"}, "--start sofa"),
        ({"fade": -1}, "--fade -1"),
    ):
        with pytest.raises(BadInput, match=words):
            shipped(PHOTO, blip, **options)


def test_the_sheet_shows_frames_and_curves(shipped, short_video, tmp_path):
    shown = curves(short_video, shipped)
    assert len(shown.level) == len(shown.speed) == FRAMES and shown.speed[0] == 0
    assert shown.codes.shape == (2, 3)
    step = (short_video.motion.shift[1] - short_video.motion.shift[0])[shipped.statistics.active]
    assert shown.speed[1] == pytest.approx(float(step.norm(dim=-1).mean()) * 25, rel=1e-4)
    line = write_sheet(short_video, shipped, tmp_path / "sheet.png")
    assert "6 of 20 frames" in line
    assert Image.open(tmp_path / "sheet.png").width > 1000


def test_pixels_in_memory_are_hashed_as_they_are(shipped, blip):
    image = Image.open(PHOTO)
    made = shipped(image, blip, view=View(crop=Crop(0, 0, 400)))
    assert made.record["settings"]["crop"] == "0,0,400" and made.record["inputs"]["photo"] is image
