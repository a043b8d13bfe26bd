"""Scores of rows: the truth is perfect where it must be, nothing is put in place of no score."""

import dataclasses
import json

import numpy as np
import pytest

from angie.evaluation import report, rows, scoring
from angie.evaluation.definitions import ALL, IMAGES, MOTION
from angie.evaluation.page import page
from angie.evaluation.report import numbers_of_images
from angie.metrics.score import Score


@pytest.fixture(scope="module")
def judge(space, model):
    return scoring.make_judge(space, model)


def scores_of(row, judge):
    return scoring.score_motion(row.runs[0], judge)


def test_the_truth_is_perfect_where_it_must_be(space, judge):
    scores = scores_of(rows.ground_truth(space), judge)
    assert {d.key for d in MOTION} == set(scores)
    for key in ("fgd", "fgd_raw", "hellinger", "hellinger_active", "maje", "maje_px", "mad"):
        assert scores[key].value == pytest.approx(0, abs=1e-9), key
    for key in ("cca", "cca_global"):
        assert scores[key].value == pytest.approx(1), key
    assert scores["pmb"].value == 100  # the fixture's onsets are the truth's own beats


def test_the_motionless_speaker_has_no_beats_and_says_so(space, judge):
    scores = scores_of(rows.motionless(space), judge)
    for key in ("bc", "pmb", "align_aist", "align_bailando"):
        assert scores[key].value is None and "without motion beats" in scores[key].reason, key
    assert scores["cca"].value is None and "no dimension varies" in scores["cca"].reason
    assert scores["acceleration"].value == scores["jerk"].value == 0
    assert scores["fgd"].value > 0 and scores["hellinger"].value > 0.5
    assert scores["maje_px"].value == pytest.approx(scores["maje"].value * 128 / 1000)


def test_motion_to_another_sound_matches_less(space, judge):
    true = scores_of(rows.ground_truth(space), judge)
    other = scores_of(rows.mismatched(space, [0]), judge)
    assert other["bc"].value < true["bc"].value and other["pmb"].value < true["pmb"].value


def test_one_speaker_is_judged_by_their_own_motion(space, judge):
    only = judge.only("ada")
    run = [p for p in rows.ground_truth(space).runs[0] if p.speaker == "ada"]
    assert len(only.real) == len(run) == 2
    assert scoring.score_motion(run, only)["fgd"].value == pytest.approx(0, abs=1e-9)


def test_an_unknown_speaker_and_unknown_truth_are_scored_as_far_as_they_can_be(space, judge):
    run = [
        dataclasses.replace(p, speaker=None, truth=None, onsets=np.zeros(0))
        for p in rows.ground_truth(space).runs[0]
    ]
    scores = scoring.score_motion(run, judge)
    assert scores["fgd"].value is not None and scores["hellinger"].value == 0
    assert "not known" in scores["maje"].reason and "without onsets" in scores["bc"].reason


def test_without_an_auto_encoder_its_scores_are_missing(space):
    scores = scoring.score_motion(rows.ground_truth(space).runs[0], scoring.make_judge(space, None))
    for key in ("fgd", "diversity", "diversity_ha2g", "diversity_pairs"):
        assert "no auto-encoder" in scores[key].reason
    assert scores["fgd_raw"].value == pytest.approx(0, abs=1e-9)


def test_the_interval_is_students(space):
    scores = [Score(v) for v in (1.0, 2.0, 3.0)]
    summary = scoring.summarise(scores)
    assert summary.mean == 2
    assert summary.interval == pytest.approx(4.30265273 / 3**0.5)
    assert scoring.summarise(scores[:1]).interval is None
    broken = scoring.summarise([*scores, Score.missing("nothing moves")])
    assert broken.mean is None and broken.reason == "in 1 of 4 runs: nothing moves"
    assert scoring.summarise([Score.missing("nothing moves")]).reason == "nothing moves"


@pytest.fixture(scope="module")
def numbers(space, judge):
    made = [rows.ground_truth(space), rows.motionless(space), rows.mismatched(space, [0, 1])]
    bins = report.speed_bins(made[0].runs[0], judge)
    told = [report.numbers_of_row(row, judge, bins) for row in made]
    name = space.test[0].name
    images = {d.key: Score(0.25) for d in IMAGES} | {"aed": Score.missing("no <network>")}
    one = report.numbers_of_space(space, judge, made, told, name, bins, {"a": "b"}, {"mine": {}})
    one |= {
        "images": {"about": "All.", "rows": [numbers_of_images("mine", "Drawn.", images)]},
        "people": None,
        "videos": ["videos-0/a.mp4"],
    }
    sizes = {"test_clips": 4, "train_clips": 8, "test_minutes": 1.0, "train_minutes": 2.0}
    data = {"name": "set", "sha256": "0" * 64, "fps": 25, "speakers": ["ada", "bob"], **sizes}
    return {
        "angie": "1", "commit": "2", "dataset": data, "options": {"seeds": 2}, "spaces": [one],
        "definitions": [dataclasses.asdict(d) for d in ALL],
    }  # fmt: skip


def test_the_files_of_a_report(numbers, tmp_path):
    report.write_report(tmp_path, "set", numbers)
    read = json.loads((tmp_path / "results.json").read_text())
    assert read["spaces"][0]["rows"][2]["runs"] == 2
    lines = (tmp_path / "table.csv").read_text().splitlines()
    assert len(lines) == 1 + 3 * len(MOTION) + len(IMAGES)
    assert "abc,motion,ground truth,1,maje,1/1000,0,," in lines
    html = (tmp_path / "report.html").read_text()
    assert "no &lt;network&gt;" in html and "<network>" not in html
    assert html.count("<svg") >= 9 and 'src="videos-0/a.mp4"' in html
    assert html == page("set", numbers)


def test_the_warnings_name_what_is_meant(numbers):
    assert any(
        "FGD: " in line and "windows for 32" in line for line in numbers["spaces"][0]["warnings"]
    )


def test_the_table_on_a_terminal_lines_up(numbers):
    lines = report.terminal_table(numbers).splitlines()
    assert "FGD" in lines[0] and "BC" in lines[0] and "AKD" not in lines[0]
    assert lines[2].startswith("motionless") and " - " in lines[2]
    assert "+-" in lines[3]
    assert len({len(line) for line in lines[:4]}) == 1
    assert "AED" not in lines[5] and "0.2500" in lines[6]
