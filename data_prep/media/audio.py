"""Recordings as mono samples, as the networks hear them."""

import io
from array import array
from pathlib import Path

import numpy as np
import soundfile
import soxr

from data_prep.errors import BadInput, note
from data_prep.media.channels import cancelled
from data_prep.media.recording import MAX_GAP, Recording, open_recording
from data_prep.media.sound_track import AUDIBLE, sound_track
from data_prep.rates import SAMPLE_RATE

__all__ = [
    "AUDIBLE", "MAX_GAP", "Recording", "open_recording", "read_sound", "sound_track", "write_wav",
]  # fmt: skip


def read_sound(path: Path, rate: int = SAMPLE_RATE, origin: float | None = None) -> np.ndarray:
    """Read a recording, or a video's sound, as mono samples.

    The delay that codecs put before the first sample is left out. Channels are averaged; where
    they cancel out, as one that is the other inverted does, the louder one is heard, with a note.
    The resampling is band-limited with linear phase, so nothing is shifted.

    Args:
        path: any container and codec that FFmpeg decodes.
        rate: samples a second of the result.
        origin: presentation time in seconds that sample 0 shall have (a video's start, for
            sound in step with its pictures); None for the sound's own first sample.

    Returns:
        samples `(N,)` float32 in [-1, 1].

    Raises:
        BadInput: missing, a folder, 0 bytes, not media, no sound, or damaged.
    """
    samples, louder = _read(path, rate, origin, None)
    if louder is not None:
        side = ("left", "right")[louder]
        note(f"{path}: one channel is the other inverted; the {side} one is heard")
        samples, _ = _read(path, rate, origin, louder)
    return samples


def _read(
    path: Path, rate: int, origin: float | None, channel: int | None
) -> tuple[np.ndarray, int | None]:
    """Samples of a channel, or of the mean; and the louder channel if the mean cancels it out."""
    with open_recording(path) as recording:
        converter = soxr.ResampleStream(recording.rate, rate, 1, dtype="float32")
        lead = 0 if origin is None else round((recording.start - origin) * recording.rate)
        grown = array("f")  # in place: an hour of sound is large enough not to be held twice
        energy = np.zeros(recording.channels)
        of_mean = 0.0

        def put(mono: np.ndarray, last: bool = False) -> None:
            block = converter.resample_chunk(mono, last=last)
            grown.frombytes(np.clip(block, -1.0, 1.0).tobytes())

        for first in range(0, lead, recording.rate):
            put(np.zeros(min(recording.rate, lead - first), np.float32))
        count, skip = max(lead, 0), max(-lead, 0)
        for block in recording.blocks():
            mono = block.mean(axis=0) if channel is None else np.ascontiguousarray(block[channel])
            energy += np.square(block, dtype=np.float64).sum(axis=1)
            of_mean += float(np.square(mono, dtype=np.float64).sum())
            mono = mono[skip:]
            skip -= block.shape[1] - len(mono)
            count += len(mono)
            put(mono)
        length = round(count * rate / recording.rate)
        put(np.zeros(0, np.float32), last=True)
    samples = np.frombuffer(grown, np.float32)[:length]
    if not len(samples):
        raise BadInput(f"{path}: holds no sound samples; give another recording")
    louder = cancelled(energy, of_mean) if channel is None else None
    missing = length - len(samples)
    return np.pad(samples, (0, missing)) if missing > 0 else samples, louder


def write_wav(path: Path, samples: np.ndarray, rate: int = SAMPLE_RATE) -> None:
    """Write samples as a 16-bit PCM wav file.

    Args:
        path: the file to write.
        samples: `(N,)` mono or `(N, channels)` float in [-1, 1]; more is clipped.
        rate: samples a second.
    """
    clipped = np.clip(np.asarray(samples, np.float32), -1.0, 1.0)
    wav = io.BytesIO()  # what goes wrong with the disk is the system's to say
    soundfile.write(wav, clipped, rate, subtype="PCM_16", format="WAV")
    Path(path).write_bytes(wav.getbuffer())
