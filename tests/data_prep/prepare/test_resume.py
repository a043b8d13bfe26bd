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

from data_prep.dataset import Clip, Dataset
from data_prep.errors import BadInput
from data_prep.files import locked
from data_prep.media.video import VideoWriter
from data_prep.prepare.prepare import prepare
from data_prep.prepare.source import IngestionConfig
from data_prep.prepare.split import split_clips
from data_prep.prepare.summary import Summary
from data_prep.speaker.crop import Crop

ROOT = Path(__file__).parents[3]
CONFIG = IngestionConfig(crop=Crop(60, 0, 360))
CROP = "60,0,360"

Draw = Callable[..., np.ndarray]


def write_talk(path: Path, draw: Draw, number: int) -> None:
    rng = np.random.default_rng(number)
    samples = (0.1 * rng.standard_normal(64000)).astype(np.float32)
    poses = [draw(hand=h, x=240 + 10 * number) for h in np.linspace(0, 1, 9)]
    with VideoWriter(path, (480, 360), sound=(samples, 16000), crf=30) as writer:
        for k in range(100):
            writer.write(poses[round(4 - 4 * np.cos(k / 6))])


@pytest.fixture(scope="module")
def talks(tmp_path_factory: pytest.TempPathFactory, person: Draw) -> Path:
    """Three videos of 4 s, and the transcript of one."""
    folder = tmp_path_factory.mktemp("talks") / "ann"
    folder.mkdir()
    for number in range(3):
        write_talk(folder / f"{number}.mp4", person, number)
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


def test_a_later_video_is_added_alone(
    talks: Path, undisturbed: Path, tmp_path: Path, person: Draw
) -> None:
    output = tmp_path / "data"
    shutil.copytree(undisturbed, output)
    (output / "notes.txt").write_text("mine")
    splits = {clip.id: clip.split for clip in Dataset(output).clips()}
    before = {path: path.stat().st_ino for path in output.glob("*/ann_*")}
    some = tmp_path / "ann"
    shutil.copytree(talks, some)
    write_talk(some / "2-later.mp4", person, 7)
    shutil.copy(some / "2-later.mp4", some / "3.mp4")
    summary = again(some, output, add=True)
    assert summary.done_before == 3 and summary.moved == 0
    assert [(a.name, b.name) for a, b in summary.doubles] == [("3.mp4", "2-later.mp4")]
    assert len(before) >= 3 * 6
    assert all(path.stat().st_ino == inode for path, inode in before.items())
    clips = Dataset(output).clips()
    assert sorted(c.source for c in clips) == ["ann_0", "ann_1", "ann_2", "ann_2-later"]
    assert {c.id: c.split for c in clips if c.id in splits} == splits
    assert (output / "notes.txt").read_text() == "mine"
    # what was there need not be named again, and another folder's 0.mp4 is another video
    (tmp_path / "other").mkdir()
    write_talk(tmp_path / "other" / "0.mp4", person, 8)
    summary = prepare([tmp_path / "other"], output, speaker="ann", config=CONFIG, add=True)
    assert summary.done_before == 0
    assert sorted({c.source for c in summary.clips} - {c.source for c in clips}) == ["ann_0-2"]
    assert len(summary.clips) == 5


def test_a_plain_second_run_makes_only_what_is_new(
    talks: Path, undisturbed: Path, tmp_path: Path, person: Draw
) -> None:
    output, some = tmp_path / "data", tmp_path / "ann"
    shutil.copytree(undisturbed, output)
    shutil.copytree(talks, some)
    before = {path: path.stat().st_ino for path in output.glob("*/ann_*")}
    assert again(some, output).done_before == 3
    assert hashes(output) == hashes(undisturbed)
    write_talk(some / "3.mp4", person, 7)
    summary = again(some, output)
    assert summary.done_before == 3 and summary.moved == 0
    assert sorted({clip.source for clip in summary.clips}) == ["ann_0", "ann_1", "ann_2", "ann_3"]
    assert all(path.stat().st_ino == inode for path, inode in before.items())
    made = hashes(output)
    with pytest.raises(BadInput, match=r"ann_0 in it was made otherwise; --add .* --force"):
        prepare([some], output, config=IngestionConfig(crop=Crop(0, 0, 360)))
    (some / "1.mp4").unlink()
    with pytest.raises(BadInput, match="ann_1 in it is not among these videos; --add"):
        again(some, output)
    assert hashes(output) == made
    assert sorted(path.name for path in tmp_path.iterdir()) == ["ann", "data"]


def test_what_has_changed_is_made_again(talks: Path, undisturbed: Path, tmp_path: Path) -> None:
    folder, output = tmp_path / "ann", tmp_path / "data"
    shutil.copytree(undisturbed, output)
    shutil.copytree(talks, folder)
    (folder / "1.srt").write_text("1\n00:00:01,000 --> 00:00:02,000\ngood night\n")
    summary = again(folder, output, add=True)
    assert summary.done_before == 2 and len(summary.clips) == 3
    words = Dataset(output).words(Dataset(output).clips()[1])
    assert words is not None and [word.word for word in words] == ["good", "night"]
    before = Dataset(undisturbed).words(Dataset(undisturbed).clips()[1])
    assert before is not None and [word.word for word in before] == ["good", "morning"]
    (output / "sources" / "ann_0.json").unlink()
    with pytest.raises(BadInput, match=r"ann_0.*--force"):
        again(folder, output, add=True)
    summary = prepare([folder / "0.mp4"], output, config=CONFIG, force=True)
    assert [clip.source for clip in Dataset(output).clips()] == ["0"]


def test_the_third_video_changes_the_rule_and_this_is_told() -> None:
    clips = [Clip(f"a{i}", "a", "", f"a{i}", 0.0, 250) for i in range(3)]
    two, three = split_clips(clips[:2]), split_clips(clips)
    summary = Summary(Path("d"), (), three, before={c.id: c.split for c in two.clips})
    moved = [c.id for c in two.clips if c.split != {d.id: d.split for d in three.clips}[c.id]]
    assert summary.moved == len(moved) > 0
    assert "of another split than before" in str(summary)


def test_a_broken_transcript_is_told_and_the_video_kept(talks: Path, tmp_path: Path) -> None:
    shutil.copy(talks / "0.mp4", tmp_path)
    (tmp_path / "0.vtt").write_text("no captions at all")
    summary = prepare([tmp_path / "0.mp4"], tmp_path / "data", config=CONFIG)
    assert len(summary.clips) == 1
    assert "warning: 0.mp4: 0.vtt: cannot be read" in str(summary)
    assert Dataset(tmp_path / "data").words(summary.clips[0]) is None


def test_one_run_at_a_time(talks: Path, tmp_path: Path) -> None:
    (tmp_path / ".data.part").mkdir()
    with locked(tmp_path / ".data.part", tmp_path), pytest.raises(BadInput, match="another run"):
        again(talks, tmp_path / "data")
    assert (tmp_path / ".data.part").is_dir()


def killed_at_random(whole: float, *arguments: Path | str) -> bool:
    """Start a run and kill it at a moment drawn from its duration; whether it was still going."""
    process = start(*arguments)  # type: ignore[arg-type]
    time.sleep(random.uniform(0.05, 0.95) * whole)
    running = process.poll() is None
    kill(process)
    return running


@pytest.mark.slow
def test_twenty_kills_at_random_moments(talks: Path, undisturbed: Path, tmp_path: Path) -> None:
    expected = hashes(undisturbed)
    begun = time.monotonic()
    assert start(talks, tmp_path / "timed", "--jobs", "2").wait() == 0
    whole = time.monotonic() - begun
    random.seed(0)
    kills = 0
    while kills < 20:
        output = tmp_path / str(kills) / "data"
        output.parent.mkdir(exist_ok=True)
        jobs = str(1 + kills % 2)
        for _ in range(1 + kills % 3):  # some runs are killed more than once
            if not output.exists():
                kills += killed_at_random(whole, talks, output, "--jobs", jobs)
        if not output.exists():
            assert start(talks, output, "--jobs", jobs).wait() == 0
        assert hashes(output) == expected
        assert [path.name for path in output.parent.iterdir()] == ["data"]
        shutil.rmtree(output.parent)


@pytest.mark.slow
def test_kills_while_adding_never_break_the_dataset(talks: Path, tmp_path: Path) -> None:
    base = tmp_path / "base" / "data"
    base.parent.mkdir()
    prepare([talks / "0.mp4"], base, speaker="ann", config=CONFIG)
    old = hashes(base)
    options = ("--speaker", "ann", "--add", "--jobs")
    goal = tmp_path / "goal" / "data"
    shutil.copytree(base, goal)
    begun = time.monotonic()
    assert start(talks, goal, *options, "1").wait() == 0
    whole = time.monotonic() - begun
    expected = hashes(goal)
    assert len(expected) > len(old)
    random.seed(1)
    kills = 0
    while kills < 20:
        output = tmp_path / str(kills) / "data"
        shutil.copytree(base, output)
        jobs = str(1 + kills % 2)
        was_running = killed_at_random(whole, talks, output, *options, jobs)
        assert hashes(output) in (old, expected)
        assert start(talks, output, *options, "1").wait() == 0
        assert hashes(output) == expected
        kills += was_running
        shutil.rmtree(output.parent)
