"""Speech: a recording with its words and named features.

Onset rows for tokens, MFCC windows for frames, and onset times.
"""

from collections.abc import Callable, Iterable, Mapping
from typing import Protocol

import numpy as np
import soxr
from numpy.typing import NDArray
from scipy.fft import dct

from data_prep.rates import (
    FPS,
    SAMPLE_RATE,
    SAMPLES_PER_FRAME,
    SAMPLES_PER_TOKEN,
    frames_covering,
    tokens_covering,
)
from data_prep.speech.rhythm import beats, onset_strength, onsets, tempogram
from data_prep.speech.spectrum import HOP, cepstra, decibels, mel_power, percussive
from data_prep.speech.spectrum import MFCC_HOP as CEPSTRUM_HOP
from data_prep.speech.words import Word

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


Compute = Callable[["Speech"], NDArray]
"""Computes a feature of a recording from its samples, its words or other features."""


class FeatureStore(Protocol):
    """Where features of a recording lie, by name."""

    def read(self, name: str) -> NDArray | None:
        """A feature, or None if it is not stored."""

    def write(self, name: str, values: NDArray) -> None:
        """Store a feature that had to be computed."""


class Speech:
    """A recording with its words and its features, which are computed when first asked for.

    `speech["onset"]` is `(S, 426)` float32, one row for each token; `speech["mfcc"]` is
    `(T, 28, 12)` float32, one window for each video frame, centred on it; `speech["onset_times"]`
    is `(n,)` float32, onsets of sounds in seconds; none of them standardised. Further features
    are added by `register_feature`.

    Attributes:
        words: the words with their times in seconds, or None where they are not known.
        frames: video frames that cover the recording, T.
    """

    def __init__(
        self,
        samples: NDArray | Callable[[], NDArray] | None,
        words: Iterable[Word] | None = None,
        *,
        features: Mapping[str, NDArray] | None = None,
        frames: int | None = None,
        store: FeatureStore | None = None,
    ) -> None:
        """Take a recording.

        Args:
            samples: `(N,)` float mono at 16 kHz in [-1, 1], or a function that reads them
                whenever they are needed, or None where the features are all there is.
            words: the words, with times from the first sample.
            features: features that are known already, by name.
            frames: video frames of the recording; needed unless `samples` is an array.
            store: where other features are looked up, and kept once they were computed.

        Raises:
            ValueError: samples that are not one-dimensional or empty, or unknown length.
        """
        self.words = None if words is None else tuple(words)
        self._features: dict[str, NDArray] = dict(features or {})
        self._store = store
        self._samples: NDArray | None = None
        self._read = samples if callable(samples) else None
        if samples is not None and not callable(samples):
            self._samples = _checked(samples)
            frames = frames_covering(len(self._samples))
        if frames is None or frames < 1:
            raise ValueError(f"speech of {frames} frames; give its samples or its length")
        self.frames = frames
        self._seconds = frames / FPS if self._samples is None else len(self._samples) / SAMPLE_RATE

    @classmethod
    def of_features(
        cls,
        features: Mapping[str, NDArray],
        frames: int,
        words: Iterable[Word] | None = None,
    ) -> "Speech":
        """Speech of `frames` video frames of which the features are known, but not the sound."""
        return cls(None, words, features=features, frames=frames)

    @property
    def samples(self) -> NDArray:
        """The sound, `(N,)` float32 mono at 16 kHz; of a dataset's clip it is read each time.

        Raises:
            ValueError: it was forgotten or never there.
        """
        if self._samples is None:
            if self._read is None:
                raise ValueError("this speech has no samples, so no other feature can be computed")
            return _checked(self._read())
        return self._samples

    @property
    def seconds(self) -> float:
        """Length of the recording, or of its video frames where only features are known."""
        return self._seconds

    @property
    def tokens(self) -> int:
        """Motion tokens that cover the recording, S."""
        return tokens_covering(self.frames)

    def __contains__(self, name: str) -> bool:
        """Whether a feature is known already, without being computed."""
        return name in self._features

    def __getitem__(self, name: str) -> NDArray:
        """A feature by its name.

        Raises:
            KeyError: no such feature.
            ValueError: it was not computed before the samples were forgotten.
        """
        if name in self._features:
            return self._features[name]
        values = None if self._store is None else self._store.read(name)
        if values is None:
            if name not in FEATURES:
                raise KeyError(f"no speech feature {name!r}; known are {', '.join(FEATURES)}")
            values = FEATURES[name](self)
            if self._store is not None:
                self._store.write(name, values)
        self._features[name] = values
        return values

    def forget_samples(self) -> None:
        """Give the memory of the samples back; features that are known stay."""
        self._samples = self._read = None


def _checked(samples: NDArray) -> NDArray:
    samples = np.asarray(samples, np.float32)
    if samples.ndim != 1 or not len(samples):
        raise ValueError(f"samples {samples.shape} must be (N,) with N > 0")
    return samples


def register_feature(name: str, compute: Compute) -> None:
    """Make a feature known by a name, as datasets and `Speech` use it.

    Args:
        name: letters, digits and underscores.
        compute: gives the array of a recording; rows follow its time.

    Raises:
        ValueError: the name is taken, or is none.
    """
    if not name.isidentifier():
        raise ValueError(f"{name!r} is no name of a feature; use letters, digits and _")
    if FEATURES.setdefault(name, compute) is not compute:
        raise ValueError(f"there is another speech feature {name!r} already")


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


FEATURES: dict[str, Compute] = {
    "onset": lambda speech: onset_rows(speech.samples),
    "mfcc": lambda speech: mfcc_windows(speech.samples),
    "onset_times": lambda speech: onset_times(speech.samples),
}
"""How each feature is computed."""
