"""A study of hand-made videos: nothing tells who made what, and synthetic answers are counted."""

import json
import re
import sys

import numpy as np
import pytest

from angie.cli import main
from angie.evaluation.study import QUESTIONS, count_answers, make_study
from angie.evaluation.videos import STRIP
from data_prep.errors import BadInput
from data_prep.media.audio import read_sound
from data_prep.media.video import read_frames
from data_prep.media.writer import VideoWriter

ROWS = ("ground truth", "motionless", "ours", "theirs")
GREY = {"true regions": 60, "ours": 140, "theirs": 200}
"""Brightness of each row's column; the recorded one is black."""
LOUD = {"one": 0.1, "two": 0.5}


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    folder = tmp_path_factory.mktemp("study") / "report"
    (folder / "videos-0").mkdir(parents=True)
    for clip, level in LOUD.items():
        shades = [0, GREY["true regions"], 100, GREY["ours"], GREY["theirs"]]
        frame = np.repeat(np.array(shades, np.uint8), 256)[None, :, None].repeat(256 + STRIP, 0)
        sound = level * np.sign(np.sin(np.arange(6400) / 8)).astype(np.float32)
        path = folder / "videos-0" / f"{clip}.mp4"
        with VideoWriter(path, (256 * 5, 256 + STRIP), sound=(sound, 16_000)) as video:
            for _ in range(10):
                video.write(np.ascontiguousarray(frame.repeat(3, 2)))
    space = {
        "rows": [{"name": name} for name in ROWS],
        "videos": [f"videos-0/{clip}.mp4" for clip in LOUD],
    }
    (folder / "results.json").write_text(json.dumps({"spaces": [space]}))
    return folder


@pytest.fixture(scope="module")
def study(report):
    output = report.parent / "study"
    assert make_study(report, output).endswith("12 pairs, 6 of them controls; see README.txt")
    return output


def test_every_video_is_what_the_key_says(study):
    key = json.loads((study / "key.json").read_text())
    shown = {one["video"]: one for p in key["pairs"] for one in (p["first"], p["second"])}
    files = sorted((study / "page" / "videos").iterdir())
    assert [path.stem for path in files] == sorted(shown) and len(files) == 12
    for path in files:
        one, frames = shown[path.stem], list(read_frames(path))
        assert frames[0].shape == (256, 256, 3) and len(frames) == 10
        assert abs(float(frames[5].mean()) - GREY[one["row"]]) < 4
        assert np.abs(read_sound(path)).mean() == pytest.approx(LOUD[one["sound"]], rel=0.2)
    for pair in key["pairs"]:
        first, second = pair["first"], pair["second"]
        assert first["sound"] == first["clip"] == second["clip"]
        same = first["row"] == second["row"]
        assert same == (pair["kind"] == "control") == (second["sound"] != second["clip"])


def test_the_page_is_blind(study):
    page = (study / "page" / "index.html").read_text()
    words = (*GREY, "ground truth", "one", "two.mp4", "control")
    assert not [word for word in words if re.search(rf"\b{re.escape(word)}\b", page)]
    assert all(text in page for text in QUESTIONS.values())
    assert [path.name for path in (study / "page").iterdir()].count("key.json") == 0


def answers_of(study, folder, number, prefer):
    """A participant who prefers by `prefer(question, first, second)`: 1, 2 or 0 for neither."""
    key = json.loads((study / "key.json").read_text())
    rng, given = np.random.default_rng(number), []
    for pair in key["pairs"]:
        left, right = rng.permutation([pair["first"]["video"], pair["second"]["video"]]).tolist()
        for question in QUESTIONS:
            likes = prefer(question, pair["first"], pair["second"])
            liked = {1: pair["first"]["video"], 2: pair["second"]["video"]}.get(likes)
            choice = {left: "left", right: "right", None: "same"}[liked]
            given.append(
                {"pair": pair["number"], "left": left, "question": question, "choice": choice}
            )
    text = {"study": key["study"], "participant": f"p{number}", "answers": given}
    folder.mkdir(exist_ok=True)
    (folder / f"answers-{number}.json").write_text(json.dumps(text))


def test_synthetic_answers_are_counted_whatever_the_sides(study, tmp_path):
    rank = {"true regions": 3, "ours": 2, "theirs": 1}

    def sure(question, first, second):
        if first["row"] == second["row"]:  # a control: hears the own sound, sees no difference
            return 1 if question == "synchrony" else 0
        return 0 if question == "diversity" else 1 + (rank[first["row"]] < rank[second["row"]])

    def contrary(question, first, second):
        return {0: 0, 1: 2, 2: 1}[sure(question, first, second)]

    for number in range(6):
        answers_of(study, tmp_path / "a", number, sure if number < 4 else contrary)
    counts = {
        (c.question, c.kind, c.first, c.second): c for c in count_answers(study, tmp_path / "a")
    }
    assert len(counts) == 3 * (3 + 3)
    one = counts["realness", "rows", "ours", "theirs"]
    assert (one.answers, one.same, one.share) == (12, 0, pytest.approx(4 / 6))
    low, high = one.interval
    assert 0.1 < low < 4 / 6 < high <= 1  # two of six participants disagree
    assert counts["synchrony", "control", "ours", "ours"].share == pytest.approx(4 / 6)
    even = counts["diversity", "rows", "true regions", "ours"]
    assert (even.share, even.same, even.interval) == (0.5, 12, (0.5, 0.5))
    answers_of(study, tmp_path / "b", 0, sure)
    assert all(c.interval is None for c in count_answers(study, tmp_path / "b"))


def command(monkeypatch, capsys, *arguments):
    monkeypatch.setattr(sys, "argv", ["angie", "study", *map(str, arguments)])
    status = 0
    try:
        main()
    except SystemExit as leave:
        status = leave.code
    return status, *capsys.readouterr()


def test_the_command(study, report, tmp_path, monkeypatch, capsys):
    answers_of(study, tmp_path / "a", 0, lambda question, first, second: 1)
    answers_of(study, tmp_path / "a", 1, lambda question, first, second: 1)
    status, out, _ = command(monkeypatch, capsys, study, "--answers", tmp_path / "a")
    assert status == 0 and len(out.splitlines()) == 18
    assert "realness   true regions over ours: 100 % (95 % interval 100 to 100 %; 4 answers" in out
    assert "synchrony  ours, own sound over another's: 100 %" in out
    for arguments, words in (
        ([report], "name the folder of the study"),
        ([report, "-o", tmp_path / "s", "--rows", "ours,mine"], "--rows mine: choose from"),
        ([report, "-o", tmp_path / "s", "--rows", "ours"], "two rows are compared"),
        ([tmp_path, "-o", tmp_path / "s"], "is not a report"),
        ([report, "--answers", tmp_path / "a"], "is not a study"),
        ([study, "--answers", tmp_path], "holds no answers"),
        ([study, "--answers", tmp_path / "a", "-o", tmp_path / "s"], "takes no -o"),
    ):
        status, out, err = command(monkeypatch, capsys, *arguments)
        assert status == 2 and out == "" and words in err and err.count("\n") == 1, err
    assert not (tmp_path / "s").exists()


def test_answers_that_are_none_are_told(study, tmp_path):
    answers_of(study, tmp_path, 0, lambda question, first, second: 1)
    file = tmp_path / "answers-0.json"
    good = json.loads(file.read_text())
    for change, words in (
        ({"study": "other"}, "another study"),
        ({"answers": [{"pair": 99}]}, "not the answers of a participant"),
        ({"answers": [{**good["answers"][0], "choice": "both"}]}, "answer to no question"),
    ):
        file.write_text(json.dumps({**good, **change}))
        with pytest.raises(BadInput, match=words):
            count_answers(study, tmp_path)
    for name in ("answers-0.json", "copy.json"):
        (tmp_path / name).write_text(json.dumps(good))
    with pytest.raises(BadInput, match="once more"):
        count_answers(study, tmp_path)
