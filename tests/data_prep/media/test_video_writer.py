"""Videos: written as players expect them, the whole recording with them."""

import threading
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from data_prep.errors import BadInput
from data_prep.media.audio import open_recording, read_sound, write_wav
from data_prep.media.video import VideoWriter, read_frames

GREY = np.full((64, 64, 3), 128, np.uint8)


def noise(seconds: float, rate: int, seed: int = 0) -> np.ndarray:
    """Noise below about 2 kHz, which AAC keeps at every rate."""
    taps = np.hanning(max(rate // 1000, 8))
    white = np.random.default_rng(seed).standard_normal(round(seconds * rate) + len(taps) - 1)
    return (0.2 * np.convolve(white, taps / np.linalg.norm(taps), "valid")).astype(np.float32)


@pytest.mark.parametrize(
    ("rate", "channels", "written_rate"),
    [(8000, 1, 8000), (16000, 1, 16000), (44100, 2, 44100), (192000, 2, 96000), (9000, 1, 11025)],
)
def test_the_whole_recording_is_in_the_video(
    tmp_path: Path, rate: int, channels: int, written_rate: int
) -> None:
    seconds = 1.73
    samples = np.stack([noise(seconds, rate, c) for c in range(channels)], axis=1)
    write_wav(tmp_path / "a.wav", samples, rate)
    frames = -(-len(samples) * 25 // rate)
    with VideoWriter(tmp_path / "a.mp4", (64, 64), sound=tmp_path / "a.wav") as writer:
        for _ in range(frames):
            writer.write(GREY)
    with av.open(str(tmp_path / "a.mp4")) as container:
        video, audio = container.streams.video[0], container.streams.audio[0]
        assert video.start_time == 0 and audio.start_time == 0
        end = video.duration * video.time_base
        assert end == Fraction(frames, 25)
        assert 0 <= end - audio.duration * audio.time_base < 0.041
        assert (audio.rate, audio.channels) == (written_rate, channels)
    given = read_sound(tmp_path / "a.wav", written_rate)
    heard = read_sound(tmp_path / "a.mp4", written_rate)
    assert len(heard) >= len(given)
    size = 2 * len(heard)
    cross = np.fft.irfft(np.fft.rfft(heard, size) * np.conj(np.fft.rfft(given, size)))
    assert np.argmax(cross) == 0
    for part in (slice(0, written_rate // 5), slice(len(given) - written_rate // 5, len(given))):
        assert np.corrcoef(given[part], heard[part])[0, 1] > 0.9


def test_file_is_what_players_expect(tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    with VideoWriter(path, (64, 64), sound=(noise(0.2, 16000), 16000), comment="made") as writer:
        for _ in range(5):
            writer.write(GREY)
    data = path.read_bytes()
    assert data.find(b"moov") < data.find(b"mdat")
    with av.open(str(path)) as container:
        assert container.metadata["comment"] == "made"
        video = container.streams.video[0].codec_context
        assert (video.name, video.pix_fmt) == ("h264", "yuv420p")
        assert container.streams.audio[0].codec_context.name == "aac"
        assert (video.colorspace, video.color_primaries, video.color_trc) == (1, 1, 1)
        assert video.color_range == 1
        times = [frame.pts * frame.time_base for frame in container.decode(video=0)]
    assert times == [Fraction(i, 25) for i in range(5)]


def test_colours_are_bt709_and_come_back(tmp_path: Path) -> None:
    colours = [(255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 255, 255), (0, 0, 0), (30, 200, 90)]
    picture = np.repeat(np.array(colours, np.uint8)[None], 32, axis=0).repeat(32, axis=1)
    with VideoWriter(tmp_path / "a.mp4", picture.shape[1::-1], crf=4) as writer:
        writer.write(picture)
    with av.open(str(tmp_path / "a.mp4")) as container:
        luma = next(container.decode(video=0)).to_ndarray()[16, 16 : picture.shape[1] : 32]
    # Y = 16 + 219 (0.2126 R + 0.7152 G + 0.0722 B), ITU-R BT.709.
    expected = [16 + 219 / 255 * np.dot((0.2126, 0.7152, 0.0722), c) for c in colours]
    np.testing.assert_allclose(luma, expected, atol=1.5)
    read = next(read_frames(tmp_path / "a.mp4"))
    np.testing.assert_allclose(read[16, 16::32].astype(int), colours, atol=4)


@pytest.mark.parametrize(
    "name", ["12:30 talk.mp4", "http:x.mp4", "50%d.mp4", "a#b?c.mp4", "-a.mp4"]
)
def test_any_name_can_be_written_and_read(tmp_path: Path, monkeypatch, name: str) -> None:
    monkeypatch.chdir(tmp_path)
    with VideoWriter(Path(name), (32, 32), sound=(noise(0.2, 16000), 16000)) as writer:
        for _ in range(5):
            writer.write(np.zeros((32, 32, 3), np.uint8))
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert len(list(read_frames(Path(name)))) == 5 and len(read_sound(Path(name))) >= 3200


def test_writer_refuses_wrong_frames_and_sizes(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="even"):
        VideoWriter(tmp_path / "a.mp4", (63, 64))
    with VideoWriter(tmp_path / "a.mp4", (64, 64)) as writer:
        writer.write(GREY)
        with pytest.raises(ValueError, match="is not"):
            writer.write(GREY[:32])
        with pytest.raises(ValueError, match="is not"):
            writer.write(GREY.astype(np.float32))


def test_writer_lets_go_after_an_error(tmp_path: Path) -> None:
    before = threading.active_count()
    with pytest.raises(RuntimeError, match="mine"):
        with VideoWriter(tmp_path / "a.mp4", (64, 64), sound=(noise(1, 16000), 16000)) as writer:
            writer.write(GREY)
            raise RuntimeError("mine")
    assert threading.active_count() == before
    with pytest.raises(BadInput, match="no such file"):
        VideoWriter(tmp_path / "b.mp4", (64, 64), sound=tmp_path / "missing.wav")
    assert not (tmp_path / "b.mp4").exists()


def test_a_recording_is_not_held_whole(tmp_path: Path) -> None:
    write_wav(tmp_path / "a.wav", noise(2, 16000))
    with open_recording(tmp_path / "a.wav") as recording:
        assert max(block.shape[1] for block in recording.blocks()) < 16000


def tone_after(seconds: float, rate: int = 16000) -> np.ndarray:
    """Two seconds of silence but for a burst of noise at a time."""
    samples = np.zeros(2 * rate, np.float32)
    first = round(seconds * rate)
    samples[first : first + rate // 10] = noise(0.1, rate)
    return samples


def burst(path: Path) -> float:
    """Seconds at which the loudest part begins."""
    heard = np.abs(read_sound(path))
    return float(np.argmax(heard > 0.3 * heard.max()) / 16000)


@pytest.mark.parametrize(("length", "cut"), [(30, True), (50, False), (60, False)])
def test_sound_may_fit_the_picture(tmp_path: Path, length: int, cut: bool) -> None:
    write_wav(tmp_path / "a.wav", tone_after(0.5))
    with VideoWriter(tmp_path / "a.mp4", (64, 64), sound=tmp_path / "a.wav", fit=True) as writer:
        for _ in range(length):
            writer.write(GREY)
    assert writer.cut == cut
    with av.open(str(tmp_path / "a.mp4")) as container:
        audio = container.streams.audio[0]
        assert audio.duration * audio.time_base == Fraction(length, 25)
    assert burst(tmp_path / "a.mp4") == pytest.approx(0.5, abs=0.03)


@pytest.mark.parametrize("origin", [-0.4, 0.3])
def test_sound_may_begin_elsewhere(tmp_path: Path, origin: float) -> None:
    write_wav(tmp_path / "a.wav", tone_after(0.8))
    with VideoWriter(
        tmp_path / "a.mp4", (64, 64), sound=tmp_path / "a.wav", origin=origin, fit=True
    ) as writer:
        for _ in range(40):
            writer.write(GREY)
    assert burst(tmp_path / "a.mp4") == pytest.approx(0.8 - origin, abs=0.03)
