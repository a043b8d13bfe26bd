"""A run that is killed is continued, whatever the moment; a video that comes later is added."""

import hashlib
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from data_prep.dataset import Dataset
from data_prep.errors import BadInput
from data_prep.lock import locked
from data_prep.outcome import IngestionConfig
from data_prep.prepare import prepare
from data_prep.speaker import Crop
from data_prep.summary import Summary
from data_prep.video import VideoWriter

ROOT = Path(__file__).parents[2]
CONFIG = IngestionConfig(crop=Crop(60, 0, 360))
CROP = "60,0,360"


def write_talk(path: Path, draw: Callable[..., np.ndarray], number: int) -> None:
    rng = np.random.default_rng(number)
    samples = (0.1 * rng.standard_normal(64000)).astype(np.float32)
    poses = [draw(hand=h, x=240 + 10 * number) for h in np.linspace(0, 1, 9)]
    with VideoWriter(path, (480, 360), sound=(samples, 16000), crf=30) as writer:
        for k in range(100):
            writer.write(poses[round(4 - 4 * np.cos(k / 6))])


@pytest.fixture(scope="module")
def talks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three videos of 4 s, and the transcript of one."""
    from conftest import draw_person

    folder = tmp_path_factory.mktemp("talks") / "ann"
    folder.mkdir()
    for number in range(3):
        write_talk(folder / f"{number}.mp4", draw_person, number)
    (folder / "1.srt").write_text("1\n00:00:01,000 --> 00:00:02,000\ngood morning\n")
    return folder


@pytest.fixture(scope="module")
def undisturbed(talks: Path) -> Path:
    prepare([talks], talks.parent / "data", config=CONFIG)
    return talks.parent / "data"


def hashes(folder: Path) -> dict[str, str]:
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def start(videos: Path, output: Path, *options: str) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "angie", "prepare", str(videos), "-o", str(output)]
    return subprocess.Popen(
        [*command, "--crop", CROP, *options],
        cwd=ROOT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def kill(process: subprocess.Popen[bytes]) -> None:
    process.send_signal(signal.SIGKILL)
    process.wait()


def again(videos: Path, output: Path, **options: bool) -> Summary:
    return prepare([videos], output, config=CONFIG, **options)


def test_a_killed_run_is_continued_and_redoes_nothing(talks: Path, undisturbed: Path) -> None:
    output = talks.parent / "killed" / "data"
    output.parent.mkdir()
    part = output.parent / ".data.part"
    process = start(talks, output, "--jobs", "1")
    while len(list((part / "sources").glob("*.json"))) < 2:
        assert process.poll() is None
        time.sleep(0.01)
    kill(process)
    assert not output.exists()
    (part / "audio" / "ann_9_000.wav").write_bytes(b"of nobody")
    done = {path.stem: path for path in (part / "sources").glob("*.json")}
    times = {name: path.stat().st_mtime_ns for name, path in done.items()}
    summary = again(talks, output)
    assert summary.done_before == len(done) >= 2
    for name, then in times.items():
        assert (output / "sources" / f"{name}.json").stat().st_mtime_ns == then
    assert hashes(output) == hashes(undisturbed)
    assert [path.name for path in output.parent.iterdir()] == ["data"]


def test_two_processes_make_the_same(talks: Path, undisturbed: Path) -> None:
    output = talks.parent / "two"
    prepare([talks], output, config=CONFIG, jobs=2)
    made = hashes(output)
    expected = hashes(undisturbed)
    # the page names its dataset
    assert made.pop("report.html") != expected.pop("report.html") and made == expected


def test_a_later_video_is_added_alone(talks: Path, undisturbed: Path, tmp_path: Path) -> None:
    some, output = tmp_path / "ann", tmp_path / "data"
    shutil.copytree(talks, some)
    later = some / "2.mp4"
    later.rename(tmp_path / "2.mp4")
    again(some, output)
    (output / "notes.txt").write_text("mine")
    splits = {clip.id: clip.split for clip in Dataset(output).clips()}
    before = {path: path.stat().st_ino for path in output.glob("*/ann_*")}
    with pytest.raises(BadInput, match="--add"):
        again(some, output)
    (tmp_path / "2.mp4").rename(later)
    shutil.copy(later, some / "0-copy.mp4")
    summary = again(some, output, add=True)
    assert summary.done_before == 2 and summary.moved == 0
    assert [(a.name, b.name) for a, b in summary.doubles] == [("2.mp4", "0-copy.mp4")]
    assert all(path.stat().st_ino == inode for path, inode in before.items())
    clips = Dataset(output).clips()
    assert sorted(c.source for c in clips) == ["ann_0", "ann_0-copy", "ann_1"]
    assert {c.id: c.split for c in clips if c.id in splits} == splits
    assert (output / "notes.txt").read_text() == "mine"
    # what was there need not be named again
    write_talk(tmp_path / "new.mp4", _draw(), 7)
    summary = prepare([tmp_path / "new.mp4"], output, speaker="ann", config=CONFIG, add=True)
    assert len(summary.clips) == 4 and summary.done_before == 0


def _draw() -> Callable[..., np.ndarray]:
    from conftest import draw_person

    return draw_person


def test_what_has_changed_is_made_again(talks: Path, tmp_path: Path) -> None:
    folder, output = tmp_path / "ann", tmp_path / "data"
    folder.mkdir()
    for name in ("0.mp4", "1.mp4"):
        shutil.copy(talks / name, folder)
    again(folder, output)
    assert not list((output / "words").iterdir())
    shutil.copy(talks / "1.srt", folder)
    summary = again(folder, output, add=True)
    assert summary.done_before == 1
    words = Dataset(output).words(Dataset(output).clips()[1])
    assert words is not None and [word.word for word in words] == ["good", "morning"]
    (output / "sources" / "ann_0.json").unlink()
    with pytest.raises(BadInput, match="ann_0.*--force"):
        again(folder, output, add=True)
    (folder / "0.mp4").unlink()
    assert len(again(folder, output, force=True).clips) == 1


def test_a_broken_transcript_is_told_and_the_video_kept(talks: Path, tmp_path: Path) -> None:
    shutil.copy(talks / "0.mp4", tmp_path)
    (tmp_path / "0.vtt").write_text("no captions at all")
    summary = prepare([tmp_path / "0.mp4"], tmp_path / "data", config=CONFIG)
    assert len(summary.clips) == 1
    assert "warning: 0.mp4: 0.vtt: cannot be read" in str(summary)
    assert Dataset(tmp_path / "data").words(summary.clips[0]) is None


def test_one_run_at_a_time(talks: Path, tmp_path: Path) -> None:
    (tmp_path / ".data.part").mkdir()
    with (
        locked(tmp_path / ".data.part", tmp_path),
        pytest.raises(BadInput, match="another run"),
    ):
        again(talks, tmp_path / "data")
    assert (tmp_path / ".data.part").is_dir()


@pytest.mark.slow
def test_twenty_kills_at_random_moments(talks: Path, undisturbed: Path, tmp_path: Path) -> None:
    expected = hashes(undisturbed)
    begun = time.monotonic()
    start(talks, tmp_path / "timed", "--jobs", "2").wait()
    whole = time.monotonic() - begun
    random.seed(0)
    killed = 0
    for trial in range(20):
        output = tmp_path / str(trial) / "data"
        output.parent.mkdir()
        jobs = str(1 + trial % 2)
        for _ in range(1 + trial % 3):  # some are killed more than once
            process = start(talks, output, "--jobs", jobs)
            time.sleep(random.uniform(0.1, 1.0) * whole)
            killed += process.poll() is None
            kill(process)
        if not output.exists():
            assert start(talks, output, "--jobs", jobs).wait() == 0
        assert hashes(output) == expected
        assert [path.name for path in output.parent.iterdir()] == ["data"]
        shutil.rmtree(output.parent)
    assert killed >= 20


@pytest.mark.slow
def test_kills_while_adding_never_break_the_dataset(talks: Path, tmp_path: Path) -> None:
    base = tmp_path / "base" / "data"
    base.parent.mkdir()
    prepare([talks / "0.mp4", talks / "1.mp4"], base, speaker="ann", config=CONFIG)
    old = hashes(base)
    goal = tmp_path / "goal" / "data"
    shutil.copytree(base, goal)
    begun = time.monotonic()
    start(talks, goal, "--speaker", "ann", "--add", "--jobs", "2").wait()
    whole = time.monotonic() - begun
    expected = hashes(goal)
    assert len(expected) > len(old)
    random.seed(1)
    for trial in range(20):
        output = tmp_path / str(trial) / "data"
        shutil.copytree(base, output)
        process = start(talks, output, "--speaker", "ann", "--add", "--jobs", str(1 + trial % 2))
        time.sleep(random.uniform(0.1, 1.0) * whole)
        kill(process)
        assert hashes(output) in (old, expected)
        again_process = start(talks, output, "--speaker", "ann", "--add", "--jobs", "1")
        assert again_process.wait() == 0
        assert hashes(output) == expected
        shutil.rmtree(output.parent)
