"""Joints in place of regions: a dataset of arrays trained and generated end to end."""

import contextlib
import json
import shutil
import sys
from dataclasses import replace

import numpy as np
import pytest
from lightning_fabric import Fabric

from angie.bundle import BUNDLE, Bundle
from angie.cli import main
from angie.config import override
from angie.generators.angie.family import FAMILY
from angie.generators.stages import StageContext
from angie.motion.keypoints import KeypointDataset, read_points, read_rate, resample
from angie.parts import describe
from angie.training import Trainer
from data_prep.errors import BadInput
from data_prep.media.audio import write_wav
from mraa.training.run import RunConfig

JOINTS, FPS = 3, 15
TINY = (
    "vq.width=8 vq.codes=16 vq.code_width=8 gpt.codes=16 gpt.width=16 gpt.heads=2 gpt.layers=1 "
    "refiner.sound=8 refiner.motion=8 refiner.hidden=8 "
    "train_vq.schedule.most_steps=4 train_gpt.schedule.most_steps=4 "
    "train_refiner.schedule.most_steps=4"
).split()


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


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Twelve clips of six seconds at 15 frames a second, in pixels."""
    folder = tmp_path_factory.mktemp("joints") / "data"
    (folder / "motion").mkdir(parents=True)
    (folder / "audio").mkdir()
    rows = ["clip,speaker,split,fps"]
    rng = np.random.default_rng(0)
    for number in range(12):
        name, frames = f"c{number}", 6 * FPS
        points = np.array([[100.0, 50], [60, 120], [140, 120]]) + rng.normal(size=(frames, 3, 2))
        points[:, 1:, 1] += 20 * np.sin(np.arange(frames) / 4 + number)[:, None]
        if number % 2:
            np.save(folder / "motion" / f"{name}.npy", points.astype(np.float32))
        else:
            np.savez(folder / "motion" / f"{name}.npz", points=points)
        sound = 0.1 * rng.normal(size=6 * 16_000) * (np.arange(6 * 16_000) // 8000 % 2)
        write_wav(folder / "audio" / f"{name}.wav", sound, 16_000)
        rows.append(
            f"{name},{'ada' if number % 2 else 'bob'},{'test' if number > 9 else 'train'},{FPS}"
        )
    (folder / "clips.csv").write_text("\n".join(rows) + "\n")
    return folder


@pytest.fixture(scope="module")
def model(data):
    folder = data.parent / "model"
    old, sys.argv = (
        sys.argv,
        [
            "angie",
            "train",
            str(data),
            "-o",
            str(folder),
            "--preset",
            "tiny",
            "--device",
            "cpu",
            *TINY,
        ],
    )
    try:
        main()
    except SystemExit as leave:
        assert not leave.code
    finally:
        sys.argv = old
    return folder


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
    with pytest.raises(BadInput, match=r"cannot be read"):
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


def test_clips_that_are_too_short_are_told_with_their_folder(data, tmp_path, capsys):
    folder = tmp_path / "short"
    shutil.copytree(data, folder)
    for path in (folder / "motion").iterdir():
        points = read_points(path)[: 2 * FPS]
        path.unlink()
        np.save(path.with_suffix(".npy"), points)
    arguments = ["-o", tmp_path / "model", "--preset", "tiny", "--device", "cpu", *TINY]
    status, _, error = call(capsys, "train", folder, *arguments)
    assert status == 2 and f"{folder}: no training clip has 96 frames" in error
    assert not (tmp_path / "model").exists()


def test_an_unreadable_recording_leaves_no_bundle(data, tmp_path, capsys):
    folder = tmp_path / "data"
    shutil.copytree(data, folder)
    (folder / "audio" / "c7.wav").write_bytes(b"no sound")
    arguments = ["-o", tmp_path / "model", "--preset", "tiny", "--device", "cpu", *TINY]
    status, _, error = call(capsys, "train", folder, *arguments)
    assert status == 2 and "c7.wav" in error and error.count("\n") == 1
    assert not (tmp_path / "model").exists()


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

    def windows(self, stride, grids=1):
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
