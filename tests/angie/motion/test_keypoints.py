"""Joints in place of regions: a dataset of arrays trained and generated end to end."""

import contextlib
import json
import shutil
import sys

import numpy as np
import pytest

from angie.bundle import BUNDLE, Bundle
from angie.cli import main
from angie.motion.keypoints import KeypointDataset, read_points, read_rate, resample
from angie.parts import describe
from data_prep.errors import BadInput

JOINTS, FPS = 3, 15


def call(capsys, *arguments):
    status, old, sys.argv = 0, sys.argv, ["angie", *map(str, arguments)]
    try:
        main()
    except SystemExit as leave:
        status = leave.code or 0
    finally:
        sys.argv = old
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def test_the_index_and_the_arrays_are_read(data, tmp_path):
    joints = KeypointDataset(data, tmp_path / "cache")
    assert joints.joints() == JOINTS and joints.speakers() == ["ada", "bob"]
    assert [clip.id for clip in joints.clips("test")] == ["c10", "c11"]
    clip = joints.motion_clips("test")[0]
    # 90 frames at 15 last to 89/15 s: 148.3 frames at 25
    assert clip.motion.shift.shape == (149, 3, 2) and not clip.motion.has_extent
    assert joints.clips("test")[0].n_frames == 149
    again = KeypointDataset(data, tmp_path / "cache").motion_clips("test")[0]
    assert np.array_equal(again.speech["onset"], clip.speech["onset"])


def test_resampling_keeps_smooth_motion():
    time = np.arange(61) / 15
    points = np.stack([np.sin(time), np.cos(time)], axis=-1)[:, None]  # (61, 1, 2)
    fine = resample(points, 15, 25)
    assert np.allclose(fine[:, 0, 0], np.sin(np.arange(len(fine)) / 25), atol=1e-3)
    assert len(fine) == 101
    back = resample(fine, 25, 15)
    assert len(back) == 61 and np.abs(back - points)[3:-3].max() < 5e-3
    assert resample(points, 15, 15) is points
    line = np.arange(10.0)[:, None, None] * np.ones((1, 1, 2))
    assert np.allclose(resample(line, 10, 5)[1:-1, 0, 0], [2, 4, 6], atol=0.05)


def test_a_model_of_joints_has_no_renderer_and_one_stream(model):
    bundle = Bundle.open(model)
    assert list(bundle.manifest["parts"]) == [
        "statistics",
        "angie.vq",
        "angie.gpt",
        "angie.refiner",
    ]
    assert bundle.preset.points and bundle.settings("angie").vq.regions == JOINTS
    assert "3 joints" in describe(bundle) and "renderer" not in describe(bundle)
    report = bundle.report("angie.vq")
    assert report["training"]["shift_perplexity"] >= 1
    assert all(len(pair) == 2 for pair in report["pairs"])


def test_motion_is_written_at_the_rate_asked_for(model, data, tmp_path, capsys):
    out, sound = tmp_path / "out.npz", data / "audio" / "c11.wav"
    start = data / "motion" / "c11.npy"
    status, text, _ = call(
        capsys, "gestures", model, sound, "-o", out, "--fps", FPS, "--start", start
    )
    assert status == 0 and "at 15 a second" in text
    with np.load(out) as file:
        points = file["points"]
        assert points.shape == (90, JOINTS, 2) and float(file["fps"]) == FPS
    assert np.allclose(points[0], np.load(start)[0], atol=0.01)  # in the unit of the data
    plain = tmp_path / "out.npy"
    assert call(capsys, "gestures", model, sound, "-o", plain, "--speaker", "bob")[0] == 0
    assert np.load(plain).shape == (150, JOINTS, 2)


def test_models_and_arrays_are_scored_beside_the_baselines(model, data, tmp_path, capsys):
    """What the paper's Table 1 asks for; arrays are any system's, here the truth and half of it."""
    for name, size in (("same", 1.0), ("half", 0.5)):
        (tmp_path / name).mkdir()
        for clip in ("c10", "c11"):
            points = read_points(next((data / "motion").glob(f"{clip}.np?")))
            middle = points.mean(0)
            np.save(tmp_path / name / f"{clip}.npy", middle + size * (points - middle))
    (tmp_path / "half" / "c11.npy").unlink()
    report = tmp_path / "report"
    status, text, _ = call(
        capsys, "evaluate", data, model, tmp_path / "same", tmp_path / "half", "-o", report,
        "--seeds", 2, "--fgd-steps", 5,
    )  # fmt: skip
    assert status == 0 and "MAJE px" not in text  # their unit is no pixel
    assert {path.name for path in report.iterdir()} == {
        "results.json", "table.csv", "report.html", "fgd-0.safetensors"
    }  # fmt: skip
    (space,) = json.loads((report / "results.json").read_text())["spaces"]
    rows = {row["name"]: row for row in space["rows"]}
    assert list(rows) == [
        "ground truth", "motionless", "mismatched", "nearest audio", "model", "same", "half"
    ]  # fmt: skip
    scores = {
        name: {key: score["mean"] for key, score in row["scores"].items()}
        for name, row in rows.items()
    }
    assert scores["same"] == pytest.approx(scores["ground truth"], abs=1e-5)
    assert scores["same"]["fgd"] == pytest.approx(0, abs=1e-6) and scores["same"]["maje"] == 0
    assert scores["half"]["fgd"] > 1e-4 < scores["model"]["fgd"]
    assert scores["half"]["acceleration"] < 0.7 * scores["same"]["acceleration"]
    assert rows["half"]["clips"] == 1 and "1 of 2" in rows["half"]["about"]
    assert rows["model"]["runs"] == 2 and space["kind"] == "joints"
    assert scores["motionless"]["bc"] is None
    page = (report / "report.html").read_text()
    assert "mean speed, units/s" in page and "joints of the dataset sha256" in page


def test_arrays_that_end_early_are_told_and_a_joint_that_never_moves_is_left_out(
    data, tmp_path, capsys
):
    folder, early = tmp_path / "data", tmp_path / "early"
    shutil.copytree(data, folder)
    early.mkdir()
    for path in sorted((folder / "motion").iterdir()):
        points = read_points(path)
        points[:, 0] = 0  # as a root that all others are given from
        path.unlink()
        np.save(path.with_suffix(".npy"), points)
        np.save(early / f"{path.stem}.npy", points[:30])
    report = tmp_path / "report"
    status, text, error = call(
        capsys, "evaluate", folder, early, "-o", report, "--fgd-steps", 2, "--videos-shown", 0
    )
    assert status == 0 and "2 arrays, such as c10, are not as long" in text + error
    (space,) = json.loads((report / "results.json").read_text())["spaces"]
    assert space["active_regions"] == [1, 2]
    assert "3.9 of 11.9 s" in space["rows"][-1]["about"]


def test_what_cannot_be_scored_on_joints_is_told(model, data, tmp_path, capsys):
    folder = tmp_path / "arrays"
    folder.mkdir()
    for place, words in (
        (folder, "no array named like a test clip"),
        (tmp_path / "nowhere", "is not a folder"),
        (BUNDLE, "is a model of regions"),
    ):
        status, _, error = call(capsys, "evaluate", data, place, "-o", tmp_path / "report")
        assert status == 2 and words in error and error.count("\n") == 1
    np.save(folder / "c10.npy", np.zeros((90, 5, 2)))
    status, _, error = call(capsys, "evaluate", data, folder, "-o", tmp_path / "report")
    assert status == 2 and "has 5 joints" in error and "3" in error
    (folder / "c10.npy").unlink()
    good = np.zeros((90, JOINTS, 2))
    for arrays, words in (
        ({"points": good, "fps": 0.0}, "not a rate from 1 to 1000"),
        ({"points": good, "fps": np.array([None])}, "no array file"),
        ({"joints": good}, "no array `points`"),
    ):
        np.savez(folder / "c10.npz", **arrays)
        status, _, error = call(capsys, "evaluate", data, folder, "-o", tmp_path / "report")
        assert status == 2 and words in error and error.count("\n") == 1
    np.savez(folder / "c10.npz", points=good)
    whole = (folder / "c10.npz").read_bytes()
    for damage in range(0, 300, 7):  # of the archive's and the array's heads
        broken = bytearray(whole)
        broken[damage] ^= 0xFF
        (folder / "c10.npz").write_bytes(broken)
        with contextlib.suppress(BadInput):
            read_points(folder / "c10.npz")
    np.save(folder / "c10.npy", np.zeros((90, JOINTS, 2)))
    (folder / "c10.npy").rename(folder / "c10.npz")
    assert read_points(folder / "c10.npz").shape == good.shape
    assert read_rate(folder / "c10.npz") is None
    assert not (tmp_path / "report").exists()


def test_going_on_and_other_stages(model, data, tmp_path, capsys):
    copy = tmp_path / "model"
    shutil.copytree(model, copy)
    status, _, error = call(capsys, "train", data, "-o", copy, "--resume", "--device", "cpu")
    assert status == 0 and "refiner: done before" in error
    status, _, error = call(capsys, "train", data, "-o", copy, "--stage", "renderer")
    assert status == 2 and "this bundle has motion" in error


@pytest.mark.parametrize(
    "row, words",
    [
        ("c1,ada,train", "fps"),
        ("c1,ada,train,fast", "not a rate"),
        ("c1,ada,valid,15", "train, val or test"),
        ("c1,,train,15", "speaker"),
        ("../c1,ada,train,15", "a name"),
        ("nothing,ada,train,15", "motion/nothing.npy is missing"),
        ("c1,ada,train,15\nc1,ada,train,15", "twice"),
    ],
)
def test_a_bad_index_is_told(data, tmp_path, row, words):
    folder = tmp_path / "data"
    shutil.copytree(data, folder)
    (folder / "clips.csv").write_text(f"clip,speaker,split,fps\n{row}\n")
    with pytest.raises(BadInput, match=words):
        KeypointDataset(folder, tmp_path / "cache")


@pytest.mark.parametrize("header", ["clip,speaker,splitt,fps", "clip,speaker", ""])
def test_a_column_that_is_missing_is_told(data, tmp_path, header):
    (tmp_path / "clips.csv").write_text(f"{header}\nc1,ada,train,15\n")
    with pytest.raises(BadInput, match=r"clips\.csv: needs the columns clip, speaker, split, fps"):
        KeypointDataset(tmp_path, tmp_path / "cache")


def test_bad_arrays_are_told(data, tmp_path):
    path = tmp_path / "a.npy"
    for array, words in [
        (np.zeros((5, 3)), r"\(5, 3\)"),
        (np.full((5, 3, 2), np.nan), "finite"),
        (np.full((5, 3, 2), 1e300), r"a\.npy: .*finite number in float32"),
        (np.zeros((5, 3, 2), complex), "finite"),
        (np.zeros((0, 3, 2)), "wanted are joints"),
    ]:
        np.save(path, array)
        with pytest.raises(BadInput, match=words):
            read_points(path)
    path.write_text("no array")
    with pytest.raises(BadInput, match="not a readable array"):
        read_points(path)
    np.savez(tmp_path / "b.npz", joints=np.zeros((5, 3, 2)))
    with pytest.raises(BadInput, match="no array `points`"):
        read_points(tmp_path / "b.npz")
    (tmp_path / "empty").mkdir()
    with pytest.raises(BadInput, match=r"clips.csv: no such file"):
        KeypointDataset(tmp_path / "empty", tmp_path)


def test_bad_requests_leave_nothing_behind(model, data, tmp_path, capsys):
    out, sound = tmp_path / "out.npz", data / "audio" / "c11.wav"
    other = tmp_path / "other.npy"
    np.save(other, np.zeros((4, 5, 2)))
    huge = tmp_path / "huge.npy"
    np.save(huge, np.full((4, 3, 2), 1e300))
    for arguments, words in [
        (["--speaker", "adda"], "did you mean 'ada'"),
        (["--start", other], "has 5 points, the model 3"),
        (["--start", huge], "huge.npy: every joint must be a finite number in float32"),
        (["--start", tmp_path / "none.npy"], "no such file"),
    ]:
        status, _, error = call(capsys, "gestures", model, sound, "-o", out, *arguments)
        assert status == 2 and words in error and error.count("\n") == 1
    status, _, error = call(capsys, "gestures", model, sound, "-o", tmp_path / "out.txt")
    assert status == 2 and "must end in" in error
    assert sorted(path.name for path in tmp_path.iterdir()) == ["huge.npy", "other.npy"]


def test_clips_that_are_too_short_are_told_with_their_folder(data, tmp_path, capsys, tiny):
    folder = tmp_path / "short"
    shutil.copytree(data, folder)
    for path in (folder / "motion").iterdir():
        points = read_points(path)[: 2 * FPS]
        path.unlink()
        np.save(path.with_suffix(".npy"), points)
    arguments = ["-o", tmp_path / "model", "--preset", "tiny", "--device", "cpu", *tiny]
    status, _, error = call(capsys, "train", folder, *arguments)
    assert status == 2 and f"{folder}: no training clip has 96 frames" in error
    assert not (tmp_path / "model").exists()


def test_an_unreadable_recording_leaves_no_bundle(data, tmp_path, capsys, tiny):
    folder = tmp_path / "data"
    shutil.copytree(data, folder)
    (folder / "audio" / "c7.wav").write_bytes(b"no sound")
    arguments = ["-o", tmp_path / "model", "--preset", "tiny", "--device", "cpu", *tiny]
    status, _, error = call(capsys, "train", folder, *arguments)
    assert status == 2 and "c7.wav" in error and error.count("\n") == 1
    assert not (tmp_path / "model").exists()


def test_transcripts_lie_beside_the_recordings(data, model, tmp_path):
    copy, cache = tmp_path / "data", model / "train" / "features"
    shutil.copytree(data, copy)
    joints = KeypointDataset(copy, cache)
    bare = joints.digest
    assert joints.speech("c1").words is None
    (copy / "audio" / "c1.srt").write_text("1\n00:00:01,000 --> 00:00:02,000\nup here\n")
    (copy / "audio" / "c2.txt").write_text("one two three")
    again = KeypointDataset(copy, cache)
    assert [(w.word, w.start) for w in again.speech("c1").words] == [("up", 1.0), ("here", 4 / 3)]
    aligned = again.speech("c2").words
    assert [w.word for w in aligned] == ["one", "two", "three"]
    assert aligned[0].start >= 0.45  # the sound begins after half a second
    assert again.digest != bare
    (copy / "audio" / "c1.srt").write_text("nothing")
    with pytest.raises(BadInput, match="c1.srt: cannot be read as a transcript"):
        again.speech("c1")
