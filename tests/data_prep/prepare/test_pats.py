"""PATS: the table of intervals is read as it comes, what is there is cut, the rest is listed."""

import csv
from pathlib import Path

import numpy as np
import pytest

from data_prep.dataset import Dataset
from data_prep.errors import BadInput
from data_prep.media.video import VideoWriter
from data_prep.prepare.pats import pats_sources, read_intervals, read_time
from data_prep.prepare.prepare import prepare
from data_prep.prepare.source import IngestionConfig
from data_prep.speaker.crop import Crop

HEADER = "dataset,delta_time,end_time,interval_id,speaker,start_time,video_fn,video_link\n"


def row(number: int, speaker: str, start: str, end: str, file: str, link: str = "") -> str:
    return f"train,5.0,{end},{number},{speaker},{start},{file},{link}\n"


def table(path: Path, *rows: str) -> Path:
    path.write_text(HEADER + "".join(rows), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("00:13:07.250000", 787.25),
        ("1:00:07", 3607.0),
        ("13:07.5", 787.5),
        ("0 days 00:13:07.250000000", 787.25),
        ("1 day 00:00:01", 86401.0),
        ("2019-06-07 00:13:07", 787.0),
        ("787.25", 787.25),
    ],
)
def test_times_of_all_kinds(text: str, seconds: float) -> None:
    assert read_time(text) == pytest.approx(seconds)


def test_tables_that_cannot_be_used(tmp_path: Path) -> None:
    for name, text, told in [
        ("empty.csv", "", "0 bytes"),
        ("other.csv", "interval_id,speaker,start_time\n", "has no end_time, video_fn"),
        ("nobody.csv", HEADER + row(1, "jon", "0:01", "0:09", "a"), "there are jon"),
    ]:
        (tmp_path / name).write_text(text)
        with pytest.raises(BadInput, match=told):
            read_intervals(tmp_path / name, "oliver")
    with pytest.raises(BadInput, match="no such file"):
        read_intervals(tmp_path / "none.csv")


def test_rows_without_sense_are_missing(tmp_path: Path) -> None:
    path = table(
        tmp_path / "t.csv",
        row(1, "jon", "0:01", "0:09", "a"),
        row(2, "jon", "0:09", "0:01", "a"),
        row(3, "jon", "early", "0:01", "a"),
        row(4, "jon", "-1 days +23:59:00", "0:01", "a"),
        row(5, " jon ", "0:02", "0:10", "a"),
        "train,5.0,0:09,6,jon\n",
        row(7, "jon", "nan", "0:01", "a"),
    )
    intervals, bad = read_intervals(path, "jon")
    assert [(i.id, i.speaker, i.end) for i in intervals] == [("1", "jon", 9.0), ("5", "jon", 10.0)]
    assert [(b.interval.id, b.reason) for b in bad] == [
        ("2", "the interval ends before it starts"),
        ("3", "the times cannot be read"),
        ("4", "the times cannot be read"),
        ("6", "the times cannot be read"),
        ("7", "the interval ends before it starts"),
    ]


def test_videos_are_found_by_name_or_link(tmp_path: Path) -> None:
    names = (
        "Trump_-_Last Week.webm",
        "aB3-dE6_gH9.mp4",
        "Some talk [zzzzzzzzzz1].mkv",
        "sub/episode-7.mp4",
        "unused.mp4",
    )
    for name in names:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    path = table(
        tmp_path / "t.csv",
        row(1, "oliver", "0:20", "0:30", "trump - last week.mp4"),
        row(2, "oliver", "0:01", "0:09", "Trump_-_Last Week"),
        row(3, "seth", "0:01", "0:09", "x", "https://www.youtube.com/watch?v=aB3-dE6_gH9"),
        row(4, "seth", "0:01", "0:09", "y", "https://youtu.be/zzzzzzzzzz1"),
        row(5, "jon", "0:01", "0:09", "", "http://www.cc.com/video/episode-7"),
        row(6, "jon", "0:01", "0:09", "gone", "http://www.cc.com/video/gone"),
        row(7, "seth", "0:50", "0:59", "Trump_-_Last Week.mp4"),
    )
    sources, missing = pats_sources(read_intervals(path)[0], [tmp_path])
    assert [(s.path.name, s.name, [i[0] for i in s.intervals]) for s in sources] == [
        ("episode-7.mp4", "jon_episode-7", ["5"]),
        ("Trump_-_Last Week.webm", "oliver_Trump_-_Last-Week", ["2", "1"]),
        ("Some talk [zzzzzzzzzz1].mkv", "seth_Some-talk-zzzzzzzzzz1", ["4"]),
        ("Trump_-_Last Week.webm", "seth_Trump_-_Last-Week", ["7"]),
        ("aB3-dE6_gH9.mp4", "seth_aB3-dE6_gH9", ["3"]),
    ]
    assert [m.interval.id for m in missing] == ["6"]
    with pytest.raises(BadInput, match="none of the 7 .* 'trump - last week'"):
        pats_sources(read_intervals(path)[0], [tmp_path / "unused.mp4"])


def test_only_the_intervals_are_cut_and_the_missing_listed(tmp_path: Path, person) -> None:
    samples = 0.1 * np.random.default_rng(0).standard_normal(14 * 16000)
    poses = [person(hand=h) for h in np.linspace(0, 1, 9)]
    with VideoWriter(
        tmp_path / "talk.mp4", (480, 360), sound=(samples.astype(np.float32), 16000), crf=32
    ) as writer:
        for k in range(350):
            writer.write(poses[round(4 - 4 * np.cos(k / 6))])
    path = table(
        tmp_path / "t.csv",
        row(101, "jon", "00:00:08.4", "00:00:13.0", "talk.mp4"),
        row(102, "jon", "00:00:02.0", "00:00:06.5", "talk.mp4"),
        row(103, "jon", "00:00:07.0", "00:00:08.0", "talk.mp4"),
        row(104, "jon", "00:00:01.0", "00:00:09.0", "gone.mp4"),
        row(105, "bee", "00:00:01.0", "00:00:09.0", "gone.mp4"),
    )
    config = IngestionConfig(crop=Crop(60, 0, 360))
    summary = prepare([tmp_path], tmp_path / "data", speaker="jon", config=config, pats=path)
    clips = Dataset(tmp_path / "data").clips()
    assert [(c.start, c.n_frames) for c in clips] == [(2.0, 112), (8.4, 115)]
    with (tmp_path / "data" / "pats_missing.csv").open() as file:
        listed = [(r["interval_id"], r["start_time"], r["reason"]) for r in csv.DictReader(file)]
    assert listed == [
        ("104", "1.000", "no such video in the folder"),
        ("103", "7.000", "no clip kept (too short)"),
    ]
    assert "missing 2 intervals of 2 videos" in str(summary)
    # another speaker's run keeps what was listed
    again = table(tmp_path / "u.csv", row(9, "bee", "0:01", "0:06", "talk.mp4"))
    prepare([tmp_path], tmp_path / "data", config=config, pats=again, add=True)
    assert "103,jon" in (tmp_path / "data" / "pats_missing.csv").read_text()
    assert [c.speaker for c in Dataset(tmp_path / "data").clips()] == ["bee", "jon", "jon"]
