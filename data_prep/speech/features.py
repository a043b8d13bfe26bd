"""Speech: a recording with its words and named features, computed when first asked for.

The files in which a dataset keeps features.
"""

import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import soxr
from numpy.typing import NDArray

from data_prep.arrays import read_arrays
from data_prep.errors import BadInput
from data_prep.files import whole_file
from data_prep.rates import FPS, SAMPLE_RATE, frames_covering, tokens_covering
from data_prep.speech import causal
from data_prep.speech.spectra import (
    MFCC_COLUMNS,
    MFCC_ROWS,
    ONSET_SIZE,
    mfcc_windows,
    onset_rows,
    onset_times,
)
from data_prep.speech.words import Word

__all__ = [
    "FEATURES", "MFCC_COLUMNS", "MFCC_ROWS", "ONSET_SIZE", "FeatureFiles", "FeatureStore", "Speech",
    "SOUND_SIZES", "mono", "register_feature", "write_features",
]  # fmt: skip

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
    is `(n,)` float32, onsets of sounds in seconds; none of them standardised.
    `speech["onset_causal"]` is `(S, 114)` and `speech["voice_causal"]` `(S,)` float32, of sound as
    it comes (`data_prep.speech.causal`). Further features are added by `register_feature`.

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
        cls, features: Mapping[str, NDArray], frames: int, words: Iterable[Word] | None = None
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


FEATURES: dict[str, Compute] = {
    "onset": lambda speech: onset_rows(speech.samples),
    "mfcc": lambda speech: mfcc_windows(speech.samples),
    "onset_times": lambda speech: onset_times(speech.samples),
    "onset_causal": lambda speech: causal.onset_rows_causal(speech.samples),
    "voice_causal": lambda speech: causal.voice_causal(speech.samples),
}
"""How each feature is computed."""

SOUND_SIZES = {"onset": ONSET_SIZE, "onset_causal": causal.ONSET_SIZE}
"""Columns of the features that have a row for each token: of the whole recording (the paper's), and
of sound as it comes (`data_prep.speech.causal`)."""

PREPARED = ("onset", "mfcc", "onset_times")
"""Features that every prepared clip has."""


def write_features(path: Path, speech: Speech) -> None:
    """Write the `PREPARED` features of a recording as npz, by their names."""
    with Path(path).open("wb") as file:
        arrays: dict[str, Any] = {name: speech[name] for name in PREPARED}
        np.savez(file, **arrays)


class FeatureFiles:
    """Features of a clip by name: `ID.npz` with those prepared, `ID.NAME.npz` for each other.

    Args:
        path: `ID.npz`, as `write_features` wrote it.
        frames: video frames of the clip; what is stored for later ones is left out. None takes
            all that are stored.
    """

    def __init__(self, path: Path, frames: int | None = None) -> None:
        self.path = Path(path)
        self.frames = len(_read_arrays(self.path, ("mfcc",))[0]) if frames is None else frames

    def read(self, name: str) -> NDArray | None:
        """A feature, or None if it is not stored for this number of frames.

        Raises:
            BadInput: missing or damaged.
        """
        if name in PREPARED:
            return self._cut(name, _read_arrays(self.path, (name,))[0])
        path = self._other(name)
        if not path.is_file():
            return None
        values, frames = _read_arrays(path, ("values", "frames"))
        return values if frames == self.frames else None

    def _cut(self, name: str, values: NDArray) -> NDArray:
        if name == "onset_times":
            return values[values < self.frames / FPS]
        return values[: tokens_covering(self.frames) if name == "onset" else self.frames]

    def write(self, name: str, values: NDArray) -> None:
        """Store a feature that had to be computed, where the folder can be written."""
        if not os.access(self.path.parent, os.W_OK):
            return
        with whole_file(self._other(name), force=True) as part, part.open("wb") as file:
            np.savez(file, values=values, frames=np.array(self.frames))

    def _other(self, name: str) -> Path:
        return self.path.with_name(f"{self.path.stem}.{name}.npz")


def _read_arrays(path: Path, names: Iterable[str]) -> list[NDArray]:
    try:
        names = list(names)
        arrays = read_arrays(path, names)
        found = [arrays[name] for name in names]
        if not all(values.dtype.kind in "biuf" and np.isfinite(values).all() for values in found):
            raise ValueError("not numbers")
        return found
    except (ValueError, KeyError) as error:
        raise BadInput(f"{path}: damaged or missing; prepare the dataset again") from error


def mono(samples: np.ndarray, rate: int) -> np.ndarray:
    """Samples (N,) float32 at 16 kHz of samples (N,) or (N, 2) at any rate.

    Floats are in [-1, 1]; whole numbers have 16 or 32 bits.

    Raises:
        BadInput: another shape or type, nothing, or numbers that are not finite.
    """
    if not isinstance(samples, np.ndarray):
        raise BadInput(f"audio: give an array and its rate, not {type(samples).__name__} first")
    if samples.dtype in (np.int16, np.int32):
        samples = samples / -float(np.iinfo(samples.dtype).min)
    good = samples.dtype.kind == "f" and samples.ndim in (1, 2) and samples.size and rate > 0
    if not good or (samples.ndim == 2 and samples.shape[1] > 2) or not np.isfinite(samples).all():
        raise BadInput(
            "audio: give samples (N,) or (N, 2), finite floats in [-1, 1] or whole numbers of 16 "
            f"or 32 bits, and their rate, not {samples.shape} {samples.dtype} at {rate}"
        )
    mixed = samples if samples.ndim == 1 else samples.mean(axis=1)
    made = soxr.resample(mixed.astype(np.float32), rate, SAMPLE_RATE)
    return np.clip(made, -1, 1)
