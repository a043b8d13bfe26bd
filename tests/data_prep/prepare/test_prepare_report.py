"""The report: its numbers add up, its page stands alone, its sheets show the crop."""

import re
from collections import Counter
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from data_prep.dataset import Clip
from data_prep.media.video import VideoInfo, VideoWriter
from data_prep.prepare.contact_sheet import FRAMES, HEIGHT, write_sheet
from data_prep.prepare.pats import Interval, Missing
from data_prep.prepare.record import RECORDS, Record, read_records, write_record
from data_prep.prepare.report import histogram, page, report_numbers, write_report
from data_prep.prepare.source import ClipDetail, IngestionConfig, Outcome, Source, Span
from data_prep.prepare.split import split_clips
from data_prep.prepare.summary import Summary, counted
from data_prep.speaker.crop import Crop, Face

INFO = VideoInfo(480, 360, 25.0, 30.0, True, 0.0)


def record(name: str, clips: int, refused: str | None = None) -> Record:
    source = Source(Path(f"/videos/{name}.mp4"), "ann", f"ann_{name}")
    ids = [f"ann_{name}_{i:03d}" for i in range(clips)]
    outcome = Outcome(
        source,
        "0" * 64,
        INFO,
        [
            Span(0, 500, None, Crop(10, -5, 340), Face(100, 50, 60, 80), 0.02),
            Span(500, 750, "two people"),
        ],
        [Clip(id, "ann", "", source.name, 10.0 * i, 250) for i, id in enumerate(ids)],
        {id: ClipDetail(0, 80.0 + i, 1.5) for i, id in enumerate(ids)},
        Counter({"two people": 8}),
        refused,
    )
    return Record("key", outcome, IngestionConfig(), 12, ("<b>odd</b> & more",))


@pytest.fixture
def summary() -> Summary:
    records = (record("a", 2), record("b", 2), record("c", 2), record("d", 0, "no face (0 of 9)"))
    split = split_clips([clip for r in records for clip in r.clips])
    gone = Missing(Interval("7", "ann", 1.0, 9.0, "gone.mp4", ""), "no such video in the folder")
    return Summary(Path("/out/talks"), records, split, missing=(gone,))


def test_a_record_comes_back_as_it_was(tmp_path: Path) -> None:
    (tmp_path / RECORDS).mkdir()
    made = record("a", 2)
    source = Source(Path("a.mp4"), "ann", "ann_a", (("7", 0.5, 9.25),))
    config = IngestionConfig(crop=Crop(1, 2, 3), person="left")
    made = replace(made, outcome=replace(made.outcome, source=source), config=config)
    write_record(tmp_path, made)
    assert read_records(tmp_path) == {"ann_a": made}
    write_record(tmp_path, replace(made, files={"audio/gone.wav": 12}))
    assert read_records(tmp_path) == {}
    (tmp_path / RECORDS / "ann_a.json").write_text('{"key": "key"}')
    assert read_records(tmp_path) == {}


def test_numbers_add_up(summary: Summary) -> None:
    numbers = report_numbers(summary)
    # three videos of 30 s: 20 s kept, 8 s told as dropped, 2 s left over; the fourth is refused
    assert numbers["seconds"] == {"given": 120.0, "kept": 60.0, "dropped": 60.0}
    assert numbers["dropped"] == {
        "two people": 32.0,
        "no face": 22.0,
        "too short for a clip, or past the end of the sound": 6.0,
    }
    splits = numbers["speakers"]["ann"]["splits"]
    assert [splits[name]["clips"] for name in ("train", "val", "test")] == [2, 2, 2]
    assert sum(numbers["histograms"]["face_height"]["counts"]) == 6
    assert numbers["histograms"]["face_height"]["median"] == [80.5]
    assert numbers["pats_missing"]["videos"] == ["gone.mp4"]
    assert numbers["videos"][0]["spans"][1]["reason"] == "two people"


def test_what_is_negligible_is_counted_but_not_told(summary: Summary) -> None:
    few = replace(summary.records[0].outcome, dropped=Counter({"a cut": 0.04, "two people": 8.0}))
    one = replace(summary, records=(replace(summary.records[0], outcome=few),))
    assert one.dropped["a cut"] == 0.04
    told = str(one) + page("t", report_numbers(one), {})
    assert "a cut" not in told and "8.0 s: two people" in told
    assert counted(1, "clip") == "1 clip" and counted(0, "clip") == "0 clips"


def test_histograms_of_few_values() -> None:
    assert histogram([])["counts"] == []
    one = histogram([3.0])
    assert sum(one["counts"]) == 1 and one["edges"][0] == 3.0 and one["median"] == [3.0]
    assert histogram([0.0, 1.0, 1.0])["counts"][-1] == 2


def test_the_page_stands_alone_and_is_the_same_every_time(summary: Summary, tmp_path: Path) -> None:
    (tmp_path / RECORDS).mkdir()
    data = cv2.imencode(".jpg", np.zeros((8, 8, 3), np.uint8))[1].tobytes()
    (tmp_path / RECORDS / "ann_a.jpg").write_bytes(data)
    records = (replace(summary.records[0], sheet=len(data)), *summary.records[1:])
    summary = replace(summary, records=records)
    write_report(tmp_path, summary)
    page = (tmp_path / "report.html").read_text()
    for text in ("talks", "60.0 s</b> kept of 2.0 min (50%)", "refused: no face (0 of 9)"):
        assert text in page
    assert page.count("data:image/jpeg;base64,") == 1
    assert "&lt;b&gt;odd&lt;/b&gt; &amp; more" in page and "<script" not in page
    assert not re.search(r"""(?:src|href)=["'](?!data:|#)""", page)
    assert page.count("<svg") == 3
    write_report(tmp_path, summary)
    assert (tmp_path / "report.html").read_text() == page


def test_a_sheet_shows_the_crop_where_it_is(tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    with VideoWriter(path, (480, 360), crf=20) as writer:
        for k in range(150):
            writer.write(np.full((360, 480, 3), 20 + k, np.uint8))
    info = replace(INFO, duration=6.0)
    spans = [Span(0, 100, None, Crop(120, 60, 240)), Span(100, 150, "no person")]
    outcome = Outcome(Source(path, "a", "a"), info=info, spans=spans)
    size = write_sheet(tmp_path / "sheet.jpg", outcome)
    assert size == (tmp_path / "sheet.jpg").stat().st_size > 0
    sheet = cv2.imread(str(tmp_path / "sheet.jpg")).astype(int)
    width = 240  # 480 x 360 brought to a height of 180
    assert sheet.shape == (HEIGHT, FRAMES * width, 3)
    for i in range(FRAMES):  # the frame at the middle of each second: 20 + 12, 37, 62 ...
        tile = sheet[:, i * width : (i + 1) * width]
        assert np.abs(tile[40, 20] - (20 + 12.5 + 25 * i)).max() < 5
        green = tile[90, 60] - tile[90, 55]
        assert (green[1] > 60) == (i < 4)  # the left edge of the square, at 120 / 2
        red = tile[90, 1]
        assert (red[2] > red[1] + 60) == (i >= 4)
    refused = Outcome(Source(tmp_path / "none.mp4", "a", "a"), info=info)
    assert write_sheet(tmp_path / "no.jpg", refused) == 0 and not (tmp_path / "no.jpg").exists()
