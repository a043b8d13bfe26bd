"""Preparing videos: clips in step with their sound, splits, refusals, nothing left behind."""

import errno
import json
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from data_prep.dataset import Dataset
from data_prep.errors import BadInput
from data_prep.media.video import VideoWriter, read_frames
from data_prep.prepare import clips as clip_files
from data_prep.prepare import ingest as making
from data_prep.prepare.clips import LONGEST, SHORTEST, clip_bounds
from data_prep.prepare.prepare import prepare
from data_prep.prepare.source import (
    IngestionConfig,
    Source,
    find_sources,
    name_sources,
    named_by,
    names_pattern,
    plain,
)
from data_prep.speaker.crop import Crop

Draw = Callable[..., np.ndarray]


def pauses(seconds: float, at: list[float]) -> np.ndarray:
    """Noise with pauses of 0.4 s around given times."""
    t = np.arange(round(seconds * 16000)) / 16000
    sound = 0.1 * np.random.default_rng(0).standard_normal(len(t))
    for pause in at:
        sound[np.abs(t - pause) < 0.2] *= 1e-3
    return sound.astype(np.float32)


def write_talk(
    path: Path, draw: Draw, seconds: float, samples: np.ndarray | None, flashes: tuple[int, ...]
) -> None:
    """A drawn person who moves a hand; a lamp in the corner of the crop flashes."""
    path.parent.mkdir(exist_ok=True)
    sound = None if samples is None else (samples, 16000)
    poses = [draw(hand=h) for h in np.linspace(0, 1, 13)]
    with VideoWriter(path, (480, 360), sound=sound, crf=28) as writer:
        for k in range(round(seconds * 25)):
            frame = poses[round(6 - 6 * np.cos(k / 8))].copy()
            if k in flashes:
                frame[200:230, 130:160] = 255
            writer.write(frame)


def test_clips_keep_sound_and_picture_together(tmp_path: Path, person: Draw) -> None:
    flashes = (30, 120, 260, 340)
    samples = pauses(15.0, [8.0])
    for k in flashes:
        samples[k * 640 : k * 640 + 64] = 0.9
    video = tmp_path / "ann" / "talk.mp4"
    write_talk(video, person, 15.0, samples, flashes)
    words = [{"word": "one", "start": 1.2, "end": 1.5}, {"word": "two", "start": 12.0, "end": 12.2}]
    video.with_suffix(".words.json").write_text(json.dumps(words))
    summary = prepare([tmp_path / "ann"], tmp_path / "data", jobs=1)
    data = Dataset(tmp_path / "data")
    first, second = data.clips()
    assert (first.speaker, first.source, first.id) == ("ann", "ann_talk", "ann_talk_000")
    assert first.n_frames + 25 + second.n_frames == 375  # a second is left unused between splits
    assert second.start == pytest.approx(first.n_frames / 25 + 1)
    assert abs(second.start - 8.0) < 0.3
    assert (first.split, second.split) == ("train", "test")
    crop = data.manifest["sources"][0]["crop"]
    lamp = [round((c - o) * 256 / crop["size"]) for c, o in ((215, crop["y"]), (145, crop["x"]))]
    for clip in (first, second):
        store, sound = data.frames(clip), data.sound(clip)
        assert len(store) == clip.n_frames and len(sound) == 640 * clip.n_frames
        seen = [i for i in range(len(store)) if store[i][lamp[0], lamp[1]].min() > 200]
        offset = round(clip.start * 25)
        assert seen == [k - offset for k in flashes if 0 <= k - offset < clip.n_frames]
        for k in seen:
            window = np.abs(sound[k * 640 - 3200 : k * 640 + 3200])
            assert abs(int(np.argmax(window)) - 3200) < 160
        speech = data.speech(clip)
        assert len(speech["mfcc"]) == clip.n_frames
        assert len(speech["onset"]) == -(-clip.n_frames // 8)
        shown = sum(1 for _ in read_frames(data.path / "video" / f"{clip.id}.mp4"))
        assert shown == clip.n_frames + (25 if clip is first else 0)
    assert [(w.word, w.start) for w in data.words(first) or []] == [("one", 1.2)]
    (two,) = data.words(second) or []
    assert two.start == pytest.approx(12.0 - second.start, abs=1e-3)
    assert "2 clips, 0.2 min" in str(summary) and "in time, 1.0 s apart" in str(summary)


def test_unusable_videos_are_listed_and_the_others_kept(tmp_path: Path, person: Draw) -> None:
    talks = tmp_path / "talks"
    write_talk(talks / "good.mp4", person, 4.0, pauses(4.0, []), ())
    write_talk(talks / "silent.mp4", person, 4.0, None, ())
    write_talk(talks / "short.mp4", person, 2.0, pauses(2.0, []), ())
    write_talk(talks / "still.mp4", lambda hand: person(), 5.0, pauses(4.0, []), ())
    write_talk(
        talks / "empty.mp4",
        lambda hand: np.full((360, 480, 3), round(99 + 9 * hand), np.uint8),
        4.0,
        pauses(4.0, []),
        (),
    )
    (talks / "text.mp4").write_text("no video")
    summary = prepare([talks], tmp_path / "data", speaker="Ann Lee", jobs=2)
    assert [clip.id for clip in summary.clips] == ["Ann-Lee_good_000"]
    reasons = {path.stem: reason for path, reason in summary.refused}
    expected = {
        "silent": "no sound",
        "short": "shorter than 97 frames",
        "still": "without motion",
        "empty": "no person",
        "text": "not a recording or video",
    }
    assert reasons.keys() == expected.keys()
    for name, reason in expected.items():
        assert reason in reasons[name]
    sources = Dataset(tmp_path / "data").manifest["sources"]
    assert {s["file"] for s in sources if s["refused"]} == {f"{name}.mp4" for name in expected}
    assert sources[1]["file"] == "good.mp4" and len(sources[1]["sha256"]) == 64


def test_nothing_is_left_behind(tmp_path: Path, person: Draw) -> None:
    write_talk(tmp_path / "in" / "silent.mp4", person, 4.0, None, ())
    for videos, output, reason in [
        (["in"], "data", "silent.mp4: has no sound"),
        (["none.mp4"], "data", "no such file"),
        (["in"], "no/such/data", "does not exist"),
        (["in"], "in", "would replace the input"),
    ]:
        with pytest.raises(BadInput, match=reason):
            prepare([tmp_path / v for v in videos], tmp_path / output, jobs=1)
    assert [path.name for path in tmp_path.iterdir()] == ["in"]
    (tmp_path / "void").mkdir()
    with pytest.raises(BadInput, match="holds no videos"):
        prepare([tmp_path / "void"], tmp_path / "data", jobs=1)


def test_a_full_disk_stops_the_run_and_keeps_what_is_done(
    tmp_path: Path, person: Draw, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("1.mp4", "2.mp4"):
        write_talk(
            tmp_path / "ann" / name, person, 4.0 + 0.2 * (name == "2.mp4"), pauses(4, []), ()
        )
    free = shutil.disk_usage(tmp_path)
    write = clip_files.write_frames

    def fail(path: Path, frames: Iterator[bytes]) -> None:
        if "_2_" in path.name:
            monkeypatch.setattr(shutil, "disk_usage", lambda path: free._replace(free=0))
            raise RuntimeError("No space left on device")
        write(path, frames)

    monkeypatch.setattr(clip_files, "write_frames", fail)
    with pytest.raises(OSError, match="no space is left") as error:
        prepare([tmp_path / "ann"], tmp_path / "data")
    assert error.value.errno == errno.ENOSPC
    monkeypatch.undo()
    summary = prepare([tmp_path / "ann"], tmp_path / "data")
    assert summary.done_before == 1 and len(summary.clips) == 2 and not summary.refused


def test_what_fails_unexpectedly_is_told_and_tried_again(
    tmp_path: Path, person: Draw, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("1.mp4", "2.mp4"):
        write_talk(
            tmp_path / "ann" / name, person, 4.0 + 0.2 * (name == "2.mp4"), pauses(4, []), ()
        )
    (tmp_path / "ann" / "2.txt").write_text("some words")

    def fail(path: Path) -> None:
        raise RuntimeError("a bug in the reader")

    monkeypatch.setattr(making, "read_transcript", fail)
    summary = prepare([tmp_path / "ann"], tmp_path / "data")
    ((path, reason),) = summary.refused
    assert path.name == "2.mp4" and "RuntimeError: a bug in the reader" in reason
    monkeypatch.undo()
    summary = prepare([tmp_path / "ann"], tmp_path / "data")
    assert summary.done_before == 1 and len(summary.clips) == 2 and not summary.refused


def test_a_given_crop_is_taken(tmp_path: Path, person: Draw) -> None:
    write_talk(tmp_path / "talk.mp4", person, 4.0, pauses(4.0, []), ())
    prepare(
        [tmp_path / "talk.mp4"], tmp_path / "data", config=IngestionConfig(crop=Crop(10, 20, 300))
    )
    data = Dataset(tmp_path / "data")
    assert data.clips()[0].speaker == "talk"
    assert data.manifest["sources"][0]["crop"] == {"x": 10, "y": 20, "size": 300}
    with pytest.raises(BadInput, match="outside"):
        prepare(
            [tmp_path / "talk.mp4"], tmp_path / "b", config=IngestionConfig(crop=Crop(480, 0, 99))
        )


def test_cuts_fall_into_pauses() -> None:
    bounds = clip_bounds(pauses(31.0, [9.0, 11.5, 21.0]), 775)
    cuts = [stop for _, stop in bounds[:-1]]
    assert bounds[0][0] == 0 and bounds[-1][1] == 775
    assert all(a[1] == b[0] for a, b in zip(bounds, bounds[1:], strict=False))
    for cut in cuts:
        assert min(abs(cut / 25 - pause) for pause in (9.0, 11.5, 21.0)) < 0.2
    noise = pauses(60.0, [])
    for frames in range(SHORTEST, 1500, 37):
        lengths = [b - a for a, b in clip_bounds(noise, frames)]
        assert sum(lengths) == frames
        assert all(SHORTEST <= n <= LONGEST for n in lengths)


def test_odd_names_and_things_that_are_no_files(tmp_path: Path, person: Draw) -> None:
    write_talk(tmp_path / "real" / "0123.mp4", person, 4.0, pauses(4.0, []), ())
    (tmp_path / "ann").mkdir()
    (tmp_path / "ann" / "talk.mp4").symlink_to(tmp_path / "real" / "0123.mp4")
    (tmp_path / "ann" / "talk.srt").write_text("1\n00:00:01,000 --> 00:00:02,000\nbeside it\n")
    odd = os.fsencode(tmp_path / "ann") + b"/bad\xff.mp4"
    try:
        Path(os.fsdecode(odd)).write_text("no video")
    except OSError:  # file systems that take text alone
        (tmp_path / "ann" / "bad.mp4").write_text("no video")
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "ann" / "pipe.mp4")
    summary = prepare([tmp_path / "ann"], tmp_path / "data")
    (clip,) = Dataset(tmp_path / "data").clips()
    assert (clip.speaker, clip.source) == ("ann", "ann_talk")
    words = Dataset(tmp_path / "data").words(clip)
    assert words is not None and [word.word for word in words] == ["beside", "it"]
    reasons = {path.name: reason for path, reason in summary.refused}
    assert "not a recording" in reasons.pop(next(name for name in reasons if name[:3] == "bad"))
    assert all("is a pipe" in reason for reason in reasons.values())
    assert "bad" in (tmp_path / "data" / "report.html").read_text(encoding="utf-8")


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root reads all")
def test_a_folder_that_cannot_be_read_is_told(tmp_path: Path) -> None:
    (tmp_path / "ann" / "shut").mkdir(parents=True)
    (tmp_path / "ann" / "1.mp4").touch()
    (tmp_path / "ann" / "shut").chmod(0)
    with pytest.raises(BadInput, match="shut: cannot be read .*name the other"):
        find_sources([tmp_path])
    (tmp_path / "ann" / "shut").chmod(0o700)


def test_names_of_files_tell_who_is_seen_and_whose_way_of_gesturing_it_is(tmp_path: Path) -> None:
    files = [tmp_path / f"{stem}.mp4" for stem in ("AIAN_F_1_Casual_bella_005", "Bo_M_2_X_adam_0")]
    sources = [Source(path, "folder", "") for path in files]
    told = named_by(names_pattern("{person}_*_{style}_*"), sources)
    assert [(s.person, s.speaker) for s in told] == [("AIAN_F_1", "bella"), ("Bo_M_2", "adam")]
    assert [s.name for s in name_sources(told)] == [path.stem for path in files]
    (alone,) = named_by(names_pattern("{person}_*"), [Source(tmp_path / "ann_1.mp4", "x", "")])
    assert (alone.person, alone.speaker) == ("", "ann")  # one and the same
    with pytest.raises(BadInput, match=r"x\.mp4: is not named as --names says"):
        named_by(names_pattern("{person}_*"), [Source(tmp_path / "x.mp4", "x", "")])
    for wrong in ("*_*", "{person}_{person}", "["):
        with pytest.raises(BadInput, match="--names .*: put {person} and {style} into it"):
            names_pattern(wrong)


def test_sources_are_named_by_folder_or_file(tmp_path: Path) -> None:
    for name in ("Ann/1.mp4", "Ann/more/1.MOV", "Bob B/talk.mkv", "Bob B/notes.txt"):
        (tmp_path / name).parent.mkdir(exist_ok=True, parents=True)
        (tmp_path / name).touch()
    found = find_sources([tmp_path])
    assert [(s.speaker, s.name) for s in found] == [
        ("Ann", "Ann_1"),
        ("more", "more_1"),
        ("Bob-B", "Bob-B_talk"),
    ]
    assert plain("Cafe\u0301 \u00e9") == "Caf\u00e9-\u00e9"
    named = find_sources([tmp_path / "Bob B" / "talk.mkv"])
    assert [(s.speaker, s.name) for s in named] == [("talk", "talk")]
    same = find_sources([tmp_path / "Ann"], speaker="Z")
    assert [s.name for s in same] == ["Z_1", "Z_1-2"]
    assert len(find_sources([tmp_path, tmp_path / "Ann" / "1.mp4"])) == 3
