"""Recordings: read at the right time, in full, whatever the container; refused in one line."""

from pathlib import Path

import numpy as np
import pytest
import soundfile

from data_prep.errors import BadInput
from data_prep.media.audio import open_recording, read_sound, write_wav
from data_prep.media.writer import VideoWriter

SHARED = Path(__file__).resolve().parents[3].parent / "shared" / "data"


def chirp(seconds: float, rate: int) -> np.ndarray:
    """A sweep from 200 Hz to 1.5 kHz, whose place in time correlation finds exactly."""
    t = np.arange(round(seconds * rate)) / rate
    return (0.5 * np.sin(2 * np.pi * (200 * t + 650 * t**2 / seconds))).astype(np.float32)


def lag(a: np.ndarray, b: np.ndarray) -> int:
    """Samples by which `b` lies behind `a`."""
    size = len(a) + len(b)
    cross = np.fft.irfft(np.fft.rfft(b, size) * np.conj(np.fft.rfft(a, size)), size)
    peak = int(np.argmax(cross))
    return peak - size if peak > size // 2 else peak


def test_wav_comes_back_sample_for_sample(tmp_path: Path) -> None:
    samples = chirp(1.0, 16000)
    write_wav(tmp_path / "a.wav", samples, 16000)
    read = read_sound(tmp_path / "a.wav")
    assert read.dtype == np.float32
    assert read.shape == (16000,)
    np.testing.assert_allclose(read, samples, atol=1 / 32768)


@pytest.mark.parametrize("rate", [8000, 22050, 44100, 48000])
@pytest.mark.parametrize("subtype", ["PCM_16", "PCM_32", "FLOAT"])
def test_any_rate_and_depth_lands_at_16_khz_unshifted(
    tmp_path: Path, rate: int, subtype: str
) -> None:
    path = tmp_path / "a.wav"
    soundfile.write(path, chirp(1.5, rate), rate, subtype=subtype)
    read = read_sound(path)
    assert len(read) == 24000
    inner = slice(400, -400)
    np.testing.assert_allclose(read[inner], chirp(1.5, 16000)[inner], atol=5e-3)


@pytest.mark.parametrize("name", ["a.mp3", "a.ogg", "a.flac"])
def test_compressed_recordings_are_not_shifted(tmp_path: Path, name: str) -> None:
    soundfile.write(tmp_path / name, chirp(2.0, 44100), 44100)
    read = read_sound(tmp_path / name)
    # The ogg demuxer takes the first block's 128 samples for priming and ends as much earlier.
    assert abs(len(read) - 32000) <= (47 if name == "a.ogg" else 1)
    assert lag(chirp(2.0, 16000), read) == 0


def test_channels_are_averaged(tmp_path: Path) -> None:
    both = np.stack([chirp(1.0, 16000), np.zeros(16000, np.float32)], axis=1)
    write_wav(tmp_path / "a.wav", both)
    np.testing.assert_allclose(read_sound(tmp_path / "a.wav"), both.mean(axis=1), atol=1e-4)


def test_more_channels_become_two_without_clipping(tmp_path: Path) -> None:
    write_wav(tmp_path / "a.wav", np.full((16000, 6), 0.9, np.float32))
    with open_recording(tmp_path / "a.wav") as recording:
        samples = np.concatenate(list(recording.blocks()), axis=1)
    assert samples.shape == (2, 16000)
    assert 0.1 < np.abs(samples).max() <= 1.0


def test_origin_moves_the_sound_by_whole_seconds_of_picture_time(tmp_path: Path) -> None:
    samples = chirp(1.0, 16000)
    write_wav(tmp_path / "a.wav", samples)
    early = read_sound(tmp_path / "a.wav", origin=0.25)
    np.testing.assert_allclose(early, samples[4000:], atol=1e-4)
    late = read_sound(tmp_path / "a.wav", origin=-0.25)
    assert len(late) == 20000
    assert not late[:4000].any()
    np.testing.assert_allclose(late[4000:], samples, atol=1e-4)


def test_sound_of_a_video_is_read(tmp_path: Path) -> None:
    with VideoWriter(tmp_path / "a.mp4", (16, 16), sound=(chirp(1.0, 16000), 16000)) as writer:
        for _ in range(25):
            writer.write(np.zeros((16, 16, 3), np.uint8))
    assert lag(chirp(1.0, 16000), read_sound(tmp_path / "a.mp4")) == 0


def test_bad_recordings_are_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "empty.wav").touch()
    (tmp_path / "text.wav").write_text("not sound\n" * 50)
    soundfile.write(tmp_path / "none.wav", np.zeros(0, np.float32), 16000)
    with VideoWriter(tmp_path / "silent.mp4", (16, 16)) as writer:
        writer.write(np.zeros((16, 16, 3), np.uint8))
    reasons = {
        "missing.wav": "no such file",
        ".": "is a folder",
        "empty.wav": "0 bytes",
        "text.wav": "not a recording",
        "none.wav": "no sound samples",
        "silent.mp4": "has no sound",
    }
    for name, reason in reasons.items():
        with pytest.raises(BadInput, match=reason) as caught:
            read_sound(tmp_path / name)
        message = str(caught.value)
        assert message.startswith(str(tmp_path / name)) and "\n" not in message


@pytest.mark.skipif(not SHARED.is_dir(), reason="the real recordings are not here")
def test_real_recordings(tmp_path: Path) -> None:
    assert len(read_sound(SHARED / "audio" / "broken_p001.flac")) == round(8.98612 * 16000)
    flac = read_sound(SHARED / "audio" / "en_jfk_11s.flac")
    assert len(flac) == 176000
    assert lag(flac, read_sound(SHARED / "audio" / "en_jfk_11s.m4a")) == 0
    assert abs(lag(flac, read_sound(SHARED / "audio" / "en_jfk_11s.mp3"))) <= 1
    assert len(read_sound(SHARED / "audio" / "m4a_named_aac.aac")) > 9 * 16000
