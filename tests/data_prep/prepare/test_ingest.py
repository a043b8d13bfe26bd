"""Whole videos through `ingest`: sound and picture stay together, and reasons are told."""

from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from data_prep.dataset import FrameStore
from data_prep.media.video import read_frames
from data_prep.prepare.clips import FOLDERS
from data_prep.prepare.ingest import ingest
from data_prep.prepare.source import IngestionConfig, Outcome, Source
from data_prep.speaker.crop import Crop
from data_prep.speech.words import Word

RATE = 16_000
SHARED = Path(__file__).resolve().parents[3].parent / "shared" / "data" / "video"
NTSC, DOUBLE, ODD = Fraction(30000, 1001), Fraction(60000, 1001), Fraction(22131, 1000)


def room() -> np.ndarray:
    rng = np.random.default_rng(0)
    return cv2.resize(rng.integers(60, 160, (5, 8, 3)).astype(np.uint8), (128, 96))


def shown_at(times: np.ndarray, lamps: list[float]) -> list[np.ndarray]:
    """Pictures of a room with a weight that swings, and a lamp lit for 0.15 s from each time."""
    pictures = []
    for t in times:
        picture = room().copy()
        x = round(60 + 20 * np.sin(3 * t))
        picture[50:80, x : x + 12] = 200
        if any(lamp <= t < lamp + 0.15 for lamp in lamps):
            picture[8:24, 8:24] = 255
        pictures.append(picture)
    return pictures


def write(path: Path, times: np.ndarray, lamps: list[float], seconds: float) -> None:
    """A video with pictures at any times, in milliseconds, and a click with every lamp."""
    with av.open(str(path), "w") as container:
        options = {"crf": "18", "preset": "ultrafast"}
        video = container.add_stream("libx264", rate=25, options=options)
        video.width, video.height, video.pix_fmt = 128, 96, "yuv420p"
        video.codec_context.time_base = Fraction(1, 90_000)
        audio = container.add_stream("aac", rate=RATE, layout="mono")
        for t, picture in zip(times, shown_at(times, lamps), strict=True):
            frame = av.VideoFrame.from_ndarray(picture, "rgb24")
            frame.pts, frame.time_base = round(t * 90_000), Fraction(1, 90_000)
            container.mux(video.encode(frame))
        container.mux(video.encode(None))
        samples = np.zeros(round(seconds * RATE), np.float32)
        for lamp in lamps:
            samples[round(lamp * RATE) :][:64] = 0.9
        for first in range(0, len(samples), 1024):
            sound = av.AudioFrame.from_ndarray(samples[None, first : first + 1024], "fltp", "mono")
            sound.sample_rate, sound.pts, sound.time_base = RATE, first, Fraction(1, RATE)
            container.mux(audio.encode(sound))
        container.mux(audio.encode(None))


def run(path: Path, folder: Path, config: IngestionConfig, words: list[Word] | None = None):
    for name in FOLDERS:
        (folder / name).mkdir(parents=True)
    return ingest(Source(path, "ann", "ann"), folder, config, words)


def drift(outcome: Outcome, folder: Path, lamps: list[float]) -> list[float]:
    """Frames by which each click is heard after the first frame with the lamp lit."""
    offsets = []
    for clip in outcome.clips:
        store = FrameStore(folder / "frames" / f"{clip.id}.safetensors")
        lit = [bool(store[k][40, 40].min() > 225) for k in range(len(store))]
        starts = [k for k in range(1, len(lit)) if lit[k] and not lit[k - 1]]
        with av.open(str(folder / "audio" / f"{clip.id}.wav")) as file:
            blocks = [frame.to_ndarray() for frame in file.decode(audio=0)]
        sound = np.abs(np.concatenate(blocks, axis=1)[0].astype(float)) / 32768
        for start in starts:
            near = slice(max(0, (start - 5) * 640), (start + 5) * 640)
            offsets.append((near.start + int(np.argmax(sound[near]))) / 640 - start)
    assert len(offsets) == len(lamps)
    return offsets


def constant(rate: Fraction, seconds: float) -> np.ndarray:
    return np.arange(int(seconds * rate)) / float(rate)


def variable(seconds: float) -> np.ndarray:
    """Times of a phone whose rate wanders between 12 and 30 frames a second."""
    steps = np.random.default_rng(0).uniform(1 / 30, 1 / 12, int(seconds * 30))
    times = np.cumsum(steps)
    return np.asarray(times[times < seconds])


def check_drift(times: np.ndarray, lamps: list[float], seconds: float, tmp_path: Path) -> None:
    path, folder = tmp_path / "a.mp4", tmp_path / "data"
    write(path, times - times[0], lamps, seconds)
    outcome = run(path, folder, IngestionConfig(crop=Crop(0, 0, 96)))
    assert outcome.refused is None and not outcome.dropped.keys() - {"after the end of the sound"}
    assert abs(sum(clip.n_frames for clip in outcome.clips) - seconds * 25) <= 2
    # The lamp is seen with the source's first picture after it is lit, up to a source's frame
    # late, and the click is heard at once: what must not be is a change from first to last.
    late = float(np.diff(times).max()) * 25
    offsets = drift(outcome, folder, lamps)
    assert all(-late - 1 <= offset <= 0.2 for offset in offsets)
    assert abs(offsets[-1] - offsets[0]) <= max(late, 1.0)


def test_an_odd_rate_does_not_drift(tmp_path: Path) -> None:
    check_drift(constant(ODD, 9), [1.0, 8.0], 9, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("rate", [ODD, NTSC, DOUBLE, Fraction(10), None])
def test_no_rate_drifts_over_a_minute(tmp_path: Path, rate: Fraction | None) -> None:
    times = variable(60) if rate is None else constant(rate, 60)
    check_drift(times, [1.0, 14.3, 29.9, 45.2, 58.8], 60, tmp_path)


def test_sound_that_is_shorter_ends_the_clips(tmp_path: Path) -> None:
    write(tmp_path / "a.mp4", constant(Fraction(25), 8), [1.0], 5.0)
    words = [Word("one", 1.0, 1.2), Word("later", 6.0, 6.2)]
    config = IngestionConfig(crop=Crop(0, 0, 96))
    outcome = run(tmp_path / "a.mp4", tmp_path / "data", config, words)
    (clip,) = outcome.clips
    assert 125 <= clip.n_frames <= 128  # AAC's last block is padded
    assert outcome.dropped == {"after the end of the sound": (200 - clip.n_frames) / 25}
    assert (outcome.spans[-1].first, outcome.spans[-1].stop) == (clip.n_frames, 200)
    (detail,) = outcome.details.values()
    assert detail.span == 0 and detail.face_height == 0 and detail.motion > 0.05
    text = (tmp_path / "data" / "words" / "ann_000.json").read_text()
    assert "one" in text and "later" not in text


def test_silence_is_no_sound(tmp_path: Path) -> None:
    write(tmp_path / "a.mp4", constant(Fraction(25), 5), [], 5.0)
    crop = Crop(0, 0, 96)
    refused = run(tmp_path / "a.mp4", tmp_path / "a", IngestionConfig(crop=crop)).refused
    assert refused == "its sound is silence; --silent-ok keeps it for training the renderer"
    kept = run(tmp_path / "a.mp4", tmp_path / "b", IngestionConfig(crop=crop, silent_ok=True))
    assert len(kept.clips) == 1


@pytest.mark.parametrize("frames", [2, 12, 96])
def test_short_clips_are_kept_for_the_renderer_alone(tmp_path: Path, frames: int) -> None:
    write(tmp_path / "a.mp4", np.arange(frames) / 25, [0.0], frames / 25)
    crop = Crop(0, 0, 96)
    refused = run(tmp_path / "a.mp4", tmp_path / "a", IngestionConfig(crop=crop)).refused
    assert refused is not None and "shorter than 97 frames" in refused and "--silent-ok" in refused
    kept = run(tmp_path / "a.mp4", tmp_path / "b", IngestionConfig(crop=crop, silent_ok=True))
    assert [clip.n_frames for clip in kept.clips] == [frames]


def test_a_cut_and_a_still_scene(tmp_path: Path) -> None:
    path = tmp_path / "a.mkv"
    with av.open(str(path), "w") as container:
        video = container.add_stream("libx264", rate=25, options={"preset": "ultrafast"})
        video.width, video.height = 128, 96
        pictures = shown_at(np.arange(110) / 25, [])
        still = [255 - room()] * 110
        for k, picture in enumerate(pictures + still):
            frame = av.VideoFrame.from_ndarray(picture, "rgb24")
            frame.pts, frame.time_base = k, Fraction(1, 25)
            container.mux(video.encode(frame))
        container.mux(video.encode(None))
    crop = Crop(0, 0, 96)
    refused = run(path, tmp_path / "a", IngestionConfig(crop=crop))
    assert "has no sound" in (refused.refused or "") and not refused.clips
    kept = run(path, tmp_path / "b", IngestionConfig(crop=crop, silent_ok=True))
    assert [(s.first, s.stop) for s in kept.spans] == [(0, 110), (110, 220)]
    assert [(clip.id, clip.n_frames) for clip in kept.clips] == [("ann_000", 110)]
    assert kept.dropped == {"without motion": 110 / 25}
    assert kept.info is not None and not kept.info.has_sound


def test_nobody_is_told_with_a_remedy(tmp_path: Path) -> None:
    write(tmp_path / "a.mp4", constant(Fraction(25), 4.2), [1.0], 4.2)
    outcome = run(tmp_path / "a.mp4", tmp_path / "data", IngestionConfig())
    assert outcome.refused is not None
    assert outcome.refused.startswith("no person (4.2 s); ") and "--crop" in outcome.refused
    assert [span.reason for span in outcome.spans] == ["no person"]


@pytest.mark.slow
@pytest.mark.skipif(not SHARED.is_dir(), reason="the real videos are not here")
@pytest.mark.parametrize(
    ("name", "config", "seconds", "refused"),
    [
        ("latentsync_man_sofa_20s.mp4", IngestionConfig(), 19.9, None),
        ("hdtf_man_suit_6s.mp4", IngestionConfig(), 6.0, None),
        ("interview_two_people_18s.mp4", IngestionConfig(), 0, "two people"),
        ("interview_two_people_18s.mp4", IngestionConfig(person="right"), 17.4, None),
        ("ted_gesture_silent_13s.mp4", IngestionConfig(), 0, "has no sound"),
        ("ted_gesture_silent_13s.mp4", IngestionConfig(silent_ok=True), 13.2, None),
        ("grid_talker_3s.mpg", IngestionConfig(), 0, "shorter than 97 frames"),
        ("obama_weekly_address_5s.mp4", IngestionConfig(), 4.8, None),
        ("obama_pizza_34s.mp4", IngestionConfig(), 33.9, None),
        ("aoc_head_8s.mp4", IngestionConfig(), 7.9, None),
    ],
)
def test_real_videos(
    tmp_path: Path, name: str, config: IngestionConfig, seconds: float, refused: str | None
) -> None:
    outcome = run(SHARED / name, tmp_path / "data", config)
    assert sum(clip.n_frames for clip in outcome.clips) / 25 >= seconds
    assert (refused is None) == (outcome.refused is None)
    assert refused is None or refused in (outcome.refused or "")
    if name.startswith("obama"):
        (crop,) = {span.crop for span in outcome.spans}
        assert crop is not None
        # The brightest value in 5 s of each border line of the crop is no bar's.
        frames = zip(range(120), read_frames(SHARED / name), strict=False)
        brightest = np.max([frame for _, frame in frames], axis=0).max(axis=2)
        square = brightest[crop.y : crop.y + crop.size, crop.x : crop.x + crop.size]
        for line in (square[0], square[-1], square[:, 0], square[:, -1]):
            assert (line > 40).mean() > 0.3
