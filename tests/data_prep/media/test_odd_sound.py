"""Recordings that any player plays although something about them is odd."""

import struct
import warnings
from pathlib import Path

import numpy as np
import pytest
import soundfile

from data_prep.errors import BadInput, Note, collected_notes
from data_prep.media.audio import open_recording, read_sound


def tone(seconds: float, rate: int = 16000, pitch: float = 300.0) -> np.ndarray:
    t = np.arange(round(seconds * rate)) / rate
    return (0.4 * np.sin(2 * np.pi * pitch * t)).astype(np.float32)


def heard(path: Path) -> tuple[np.ndarray, list[str]]:
    """Samples and notes; no other warning may come."""
    with warnings.catch_warnings(), collected_notes() as notes:
        warnings.simplefilter("error")
        warnings.simplefilter("always", Note)
        samples = read_sound(path)
    return samples, notes


def wav(path: Path, samples: np.ndarray, claim: int | None = None, rate: int = 16000) -> Path:
    """A 16-bit WAV whose data chunk claims `claim` bytes; `(N,)` or `(N, channels)`."""
    data = (samples * 32767).astype("<i2").tobytes()
    channels = 1 if samples.ndim == 1 else samples.shape[1]
    form = struct.pack("<HHIIHH", 1, channels, rate, rate * 2 * channels, 2 * channels, 16)
    size = len(data) if claim is None else claim
    riff = struct.pack("<4sI4s4sI", b"RIFF", (size + 36) % 2**32, b"WAVE", b"fmt ", len(form))
    path.write_bytes(riff + form + struct.pack("<4sI", b"data", size) + data)
    return path


@pytest.mark.parametrize(
    "claim", [0, 0x7FFFF000, 0x7FFFFFFF, 0x7FFFFFDB, 2_000_000_000, 0xFFFFFFFF, 0xFFFFFFDB]
)
def test_a_wav_of_unknown_length_is_heard_whole_without_a_note(tmp_path, claim):
    samples, notes = heard(wav(tmp_path / "a.wav", tone(1.5), claim))
    np.testing.assert_allclose(samples, tone(1.5), atol=1e-4)
    assert notes == []


@pytest.mark.parametrize("missing", [28, 44, 7999])
def test_less_than_a_quarter_of_a_second_may_be_missing(tmp_path, missing):
    samples, notes = heard(wav(tmp_path / "a.wav", tone(1.5), 48000 + missing))
    assert len(samples) == 24000 and notes == []


@pytest.mark.parametrize("name", ["a.wav", "a.flac", "a.mp3", "a.aiff", "a.w64", "a.caf"])
def test_what_is_there_of_a_recording_that_was_cut_off_is_heard_with_a_note(tmp_path, name):
    noise = 0.1 * np.random.default_rng(0).standard_normal(64000).astype(np.float32)
    soundfile.write(tmp_path / name, noise, 16000)
    whole = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(whole[: len(whole) // 2])
    samples, notes = heard(tmp_path / name)
    assert 1.7 < len(samples) / 16000 < 2.2
    if name not in ("a.w64", "a.caf"):  # of which FFmpeg measures the file
        assert len(notes) == 1 and "its header says 4.0 s" in notes[0]
        assert notes[0].startswith(str(tmp_path / name))


def test_a_flac_with_a_damaged_block_keeps_its_time(tmp_path):
    noise = 0.1 * np.random.default_rng(0).standard_normal(64000).astype(np.float32)
    soundfile.write(tmp_path / "a.flac", noise, 16000)
    data = bytearray((tmp_path / "a.flac").read_bytes())
    data[len(data) // 2] ^= 0xFF
    (tmp_path / "a.flac").write_bytes(data)
    samples, notes = heard(tmp_path / "a.flac")
    assert len(samples) == 64000
    same = np.abs(samples - noise) < 1e-3
    silent = samples == 0
    assert (same | silent).all() and 4000 < silent.sum() < 9000
    assert len(notes) == 1 and "damaged" in notes[0]


def mp3(folder: Path, seconds: float, pitch: float = 300.0) -> bytes:
    soundfile.write(folder / "part.mp3", tone(seconds, 44100, pitch), 44100)
    return (folder / "part.mp3").read_bytes()


ID3V1 = b"TAG" + b"title".ljust(125, b"\0")
APE = b"APETAGEX" + struct.pack("<IIII", 2000, 32, 0, 0).ljust(24, b"\0")


@pytest.mark.parametrize("junk", [bytes(128), bytes(20000), ID3V1, APE, APE + ID3V1])
def test_padding_and_tags_in_an_mp3_are_passed_over(tmp_path, junk):
    first, second = mp3(tmp_path, 1.5), mp3(tmp_path, 1.5, 500.0)
    (tmp_path / "a.mp3").write_bytes(first)
    whole = len(read_sound(tmp_path / "a.mp3"))
    for behind in (b"", b"ID3\x03\0\0\0\0\x01\0" + bytes(128) + second):
        (tmp_path / "a.mp3").write_bytes(first + junk + behind)
        samples, notes = heard(tmp_path / "a.mp3")
        expected = whole + (1.5 * 16000 if behind else 0)
        assert abs(len(samples) - expected) < 0.12 * 16000  # codecs pad
        assert not any("damaged" in one for one in notes)


@pytest.mark.parametrize("subtype", ["VORBIS", "OPUS"])
@pytest.mark.parametrize("second", [(48000, 1), (24000, 1), (48000, 2)])
def test_joined_ogg_streams_are_heard_one_after_another(tmp_path, subtype, second):
    data = b""
    for seconds, pitch, rate, channels in ((0.6, 300.0, 48000, 1), (1.5, 500.0, *second)):
        sound = np.repeat(tone(seconds, rate, pitch)[:, None], channels, axis=1)
        soundfile.write(tmp_path / "part.ogg", sound, rate, format="OGG", subtype=subtype)
        data += (tmp_path / "part.ogg").read_bytes()
    (tmp_path / "a.ogg").write_bytes(data)
    samples, notes = heard(tmp_path / "a.ogg")
    assert abs(len(samples) - 2.1 * 16000) < 400 and notes == []
    for part, pitch in ((samples[2000:8000], 300.0), (samples[12000:30000], 500.0)):
        spectrum = np.abs(np.fft.rfft(part * np.hanning(len(part))))
        assert abs(spectrum.argmax() * 16000 / len(part) - pitch) < 5
    assert np.abs(samples[8000:12000]).reshape(-1, 400).max(axis=1).min() > 0.1  # no hole


def test_an_inverted_channel_leaves_the_louder_one_heard(tmp_path):
    left = tone(1.0)
    both = wav(tmp_path / "a.wav", np.stack([0.8 * left, -left], axis=1))
    samples, notes = heard(both)
    np.testing.assert_allclose(samples, -left, atol=1e-4)
    assert len(notes) == 1 and "right one is heard" in notes[0]
    # A mean with more than a tenth of the louder's energy is heard: (1 - 0.2) / 2 = 0.4.
    samples, notes = heard(wav(tmp_path / "b.wav", np.stack([left, -0.2 * left], axis=1)))
    np.testing.assert_allclose(samples, 0.4 * left, atol=1e-4)
    assert notes == []


@pytest.mark.parametrize("channels", [7, 9, 11, 13, 15, 20, 32])
def test_channels_without_a_layout_are_averaged(tmp_path, channels):
    levels = np.linspace(0.2, 1.0, channels, dtype=np.float32)
    path = wav(tmp_path / "a.wav", tone(0.5)[:, None] * levels)
    samples, notes = heard(path)
    assert notes == []
    if channels > 8:
        np.testing.assert_allclose(samples, 0.6 * tone(0.5), atol=1e-3)
    with open_recording(path) as recording:
        assert sum(block.shape[1] for block in recording.blocks()) == 8000


def test_the_loudest_is_heard_where_many_channels_cancel_out(tmp_path):
    signs = np.array([0.5, -0.5] * 6 + [0.6], np.float32)
    samples, _ = heard(wav(tmp_path / "a.wav", tone(0.5)[:, None] * signs))
    np.testing.assert_allclose(samples, 0.6 * tone(0.5), atol=1e-3)


def test_samples_that_are_no_numbers_are_silence_and_are_noted(tmp_path):
    sound = tone(1.0)
    sound[4000:4010], sound[5000], sound[6000] = np.nan, np.inf, 1e30
    soundfile.write(tmp_path / "a.wav", sound, 16000, subtype="FLOAT")
    samples, notes = heard(tmp_path / "a.wav")
    assert np.isfinite(samples).all() and np.abs(samples).max() <= 1
    assert not samples[4000:4010].any() and samples[5000] == 0 and samples[6000] == 1
    np.testing.assert_allclose(samples[6001:], tone(1.0)[6001:], atol=1e-6)
    assert len(notes) == 1 and "11 of its samples" in notes[0]


def test_a_recording_of_which_most_is_damaged_is_refused(tmp_path):
    noise = 0.1 * np.random.default_rng(0).standard_normal(64000)
    soundfile.write(tmp_path / "a.flac", noise, 16000)
    data = bytearray((tmp_path / "a.flac").read_bytes())
    for place in range(3000, len(data), 2000):
        data[place] ^= 0xFF
    (tmp_path / "a.flac").write_bytes(data)
    with pytest.raises(BadInput, match="damaged"):
        read_sound(tmp_path / "a.flac")


@pytest.mark.parametrize(
    "content, what",
    [
        (b"<!DOCTYPE html><html></html>", "a web page"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:00\n", "a Git LFS pointer"),
        (b"%PDF-1.7\n" + bytes(200), "a PDF document"),
        (b"MThd\0\0\0\6\0\1", "a MIDI file"),
    ],
)
def test_what_is_no_sound_is_called_what_it_is(tmp_path, content, what):
    (tmp_path / "a.wav").write_bytes(content)
    with pytest.raises(BadInput, match=what):
        read_sound(tmp_path / "a.wav")
