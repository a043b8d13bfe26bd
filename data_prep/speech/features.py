"""Speech features: onset rows for tokens, MFCC windows for frames, and onset times."""

from dataclasses import dataclass

import numpy as np
import soxr
from scipy.fft import dct

from data_prep.rates import (
    SAMPLE_RATE,
    SAMPLES_PER_FRAME,
    SAMPLES_PER_TOKEN,
    frames_covering,
    tokens_covering,
)
from data_prep.speech.rhythm import beats, onset_strength, onsets, tempogram
from data_prep.speech.spectrum import HOP, cepstra, decibels, mel_power, percussive
from data_prep.speech.spectrum import MFCC_HOP as CEPSTRUM_HOP

ONSET_SIZE = 426
"""Columns: MFCC 20, their deltas 20, onset strength 1, beat 1, tempogram 384."""

MFCC_ROWS = 28
"""MFCC frames in the window of one video frame: seven video frames of four."""

MFCC_COLUMNS = 12

_ONSET_RATE = SAMPLE_RATE * HOP // SAMPLES_PER_TOKEN
"""1600 Hz, at which the usual hop of 512 gives one row a token."""

_MFCCS = 20
_TEMPOGRAM = 384
_SHORTEST = 1.6
"""Seconds below which the onset recipe fails; shorter sound is mirrored up to it."""

_REACH = 3
"""Video frames before and after a frame that its MFCC window covers."""


@dataclass(frozen=True)
class SpeechFeatures:
    """Features of a recording, not standardised.

    Attributes:
        onset: `(S, 426)` float32, one row for each token.
        mfcc: `(T, 28, 12)` float32, one window for each video frame, centred on it; of
            `speech_features`, they share the rows in which they overlap.
        onset_times: `(n,)` float32, onsets of sounds in seconds.
    """

    onset: np.ndarray
    mfcc: np.ndarray
    onset_times: np.ndarray


def speech_features(samples: np.ndarray) -> SpeechFeatures:
    """Compute all features of a whole recording.

    Args:
        samples: `(N,)` float mono at 16 kHz in [-1, 1].

    Returns:
        features of `T = frames_covering(N)` frames and `S = tokens_covering(T)` tokens.

    Raises:
        ValueError: not one-dimensional, or empty.
    """
    samples = np.asarray(samples, np.float32)
    if samples.ndim != 1 or not len(samples):
        raise ValueError(f"samples {samples.shape} must be (N,) with N > 0")
    return SpeechFeatures(onset_rows(samples), mfcc_windows(samples), onset_times(samples))


def onset_rows(samples: np.ndarray) -> np.ndarray:
    """Onset features, one row for each token (ANGIE, section 4.1).

    The composition is Bailando's music feature without chroma, computed on the recording
    resampled to 1600 Hz with a hop of 512: 20 MFCC of the mel spectrogram in dB relative to its
    maximum, their deltas of width 3, the onset strength of the percussive part (median over
    bands), its beats as a one-hot column, and its tempogram of width 384. All definitions are
    librosa's.

    Args:
        samples: `(N,)` float32 mono at 16 kHz.

    Returns:
        features `(S, 426)` float32.
    """
    tokens = tokens_covering(frames_covering(len(samples)))
    least = round(_SHORTEST * SAMPLE_RATE)
    if len(samples) < least:
        samples = np.pad(samples, (0, least - len(samples)), mode="reflect")
    slow = soxr.resample(samples, SAMPLE_RATE, _ONSET_RATE)
    mel = mel_power(slow, _ONSET_RATE)
    level = decibels(mel, float(mel.max()))
    mfcc = dct(level, type=2, axis=1, norm="ortho")[:, :_MFCCS]
    strength = onset_strength(percussive(slow), _ONSET_RATE, np.median)
    beat = np.zeros_like(strength)
    beat[beats(strength, _ONSET_RATE / HOP)] = 1
    tempo = tempogram(strength, _TEMPOGRAM)
    rows = np.concatenate([mfcc, _delta(mfcc), strength[:, None], beat[:, None], tempo], axis=1)
    rows = rows[:tokens].astype(np.float32)
    return np.pad(rows, ((0, tokens - len(rows)), (0, 0)), mode="edge")


def _delta(rows: np.ndarray) -> np.ndarray:
    """Slope of a line through each row and its neighbours; the ends repeat the next one."""
    half = (rows[2:] - rows[:-2]) / 2
    return np.concatenate([half[:1], half, half[-1:]])


def mfcc_windows(samples: np.ndarray) -> np.ndarray:
    """MFCC windows, one for each video frame and centred on it (ATVGnet's audio feature).

    The recording gets 120 ms of zeros at both ends; of its 100 cepstra a second the first
    coefficient is dropped; the window of frame f is the 28 rows around its four.

    Args:
        samples: `(N,)` float32 mono at 16 kHz.

    Returns:
        windows `(T, 28, 12)` float32; they share the rows in which they overlap, a seventh of
        what copies would take.
    """
    frames = frames_covering(len(samples))
    per_frame = SAMPLES_PER_FRAME // CEPSTRUM_HOP
    count, around = (frames + 2 * _REACH) * per_frame, _REACH * SAMPLES_PER_FRAME
    rows = cepstra(samples, count, around)[:, 1:].astype(np.float32)
    windows = np.lib.stride_tricks.sliding_window_view(rows, MFCC_ROWS, axis=0, writeable=True)
    return windows[::per_frame].transpose(0, 2, 1)


def onset_times(samples: np.ndarray) -> np.ndarray:
    """Onsets of sounds in seconds, `(n,)` float32: librosa's detector at 16 kHz, hop 512."""
    rate = SAMPLE_RATE / HOP
    return (onsets(onset_strength(samples, SAMPLE_RATE), rate) / rate).astype(np.float32)
