"""Lists of jobs: read, made past what fails, and resumed."""

import csv
import shutil

import pytest

from angie.batch import read_list, run
from angie.bundle import PHOTO
from angie.request import Pipelines, Request
from data_prep.errors import BadInput


class Loaded(Pipelines):
    """The shipped pipeline, whatever is asked for."""

    def __init__(self, pipeline):
        super().__init__()
        self.pipeline, self.asked = pipeline, 0

    def of(self, request):
        self.asked += 1
        return self.pipeline


@pytest.fixture
def jobs(tmp_path, blip):
    shutil.copy(PHOTO, tmp_path / "photo.png")
    shutil.copy(blip, tmp_path / "blip.wav")
    path = tmp_path / "jobs.csv"
    path.write_text(
        "photo,audio,output,seed,full-frame\n"
        "photo.png,blip.wav,one.mp4,1,\n"
        "none.png,blip.wav,two.mp4,,yes\n"
        "photo.png,blip.wav,three.gif,2,\n"
        "photo.png,blip.wav,four.mp4,many,\n"
    )
    return path


def told(jobs):
    with jobs.with_suffix(".report.csv").open(newline="") as file:
        return {int(row["row"]): row for row in csv.DictReader(file)}


def test_a_list_is_made_past_failures_and_resumed(jobs, shipped, capsys):
    assert run(jobs, Loaded(shipped)) == 2
    captured = capsys.readouterr()
    assert "2 made, 0 there already, 2 failed" in captured.out
    assert "row 2: " in captured.err and "no such file" in captured.err
    rows = told(jobs)
    assert [row["status"] for row in rows.values()] == ["made", "failed", "made", "failed"]
    assert rows[1]["frames"] == "20" and "seed many: give a whole number" in rows[4]["message"]
    assert sorted(path.name for path in jobs.parent.glob("*.???")) == [
        "blip.wav", "jobs.csv", "jobs.report.csv", "one.mp4", "photo.png", "three.gif",
    ]  # fmt: skip
    before = (jobs.parent / "one.mp4").stat().st_mtime_ns
    again = Loaded(shipped)
    run(jobs, again)
    assert [row["status"] for row in told(jobs).values()] == ["there", "failed", "there", "failed"]
    assert again.asked == 0 and (jobs.parent / "one.mp4").stat().st_mtime_ns == before
    jobs.write_text(jobs.read_text().replace("one.mp4,1", "one.mp4,7"))
    run(jobs, again)
    assert "exists, but with another seed" in told(jobs)[1]["message"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("photo,audio\n", "has no output"),
        ("photo,output,sped\na,b,c\n", "unknown column 'sped'"),
        ("photo,output\n", "has 0 rows"),
        ("photo,output\na,b.mp4\na,./b.mp4\n", "rows 1 and 2 write"),
        ("\n", "has no photo, output"),
    ],
)
def test_lists_that_cannot_be_read_are_one_line(tmp_path, text, words):
    path = tmp_path / "jobs.csv"
    path.write_text(text)
    with pytest.raises(BadInput, match=words):
        read_list(path)


def test_rows_are_requests(tmp_path):
    path = tmp_path / "jobs.csv"
    path.write_text(
        "photo,audio,output,greedy,fade,scale_motion\n"
        "a.png,b.wav,c.mp4,yes,1.5,\n/a.png,,d.mp4,,,hull\n,b.wav,e.mp4,,,\n"
        "a.png,b.wav,,,,\n"
    )
    rows = read_list(path, {"seed": 4, "scale_motion": "none"})
    assert rows[0].request == Request(
        tmp_path / "a.png", tmp_path / "b.wav", seed=4, greedy=True, fade=1.5
    )
    assert str(rows[1].request.photo) == "/a.png" and rows[1].request.scale_motion == "hull"
    assert [row.problem[:14] for row in rows[2:]] == ["photo: is miss", "names no outpu"]
    assert [row.number for row in rows] == [1, 2, 3, 4]


@pytest.mark.slow
def test_a_list_on_a_cluster_is_made_as_here(jobs, shipped, tmp_path):
    ray = pytest.importorskip("ray")
    ray.init(address="local", num_cpus=1, include_dashboard=False, log_to_driver=False)
    try:
        assert run(jobs, Pipelines(), ray="local") == 2
    finally:
        ray.shutdown()
    rows = told(jobs)
    assert [row["status"] for row in rows.values()] == ["made", "failed", "made", "failed"]
    made = jobs.parent / "one.mp4"
    request = Request(jobs.parent / "photo.png", jobs.parent / "blip.wav", seed=1)
    again = request.make(shipped).save(tmp_path / "again.mp4")
    assert made.read_bytes() == again.read_bytes()
