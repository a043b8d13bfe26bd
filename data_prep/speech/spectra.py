"""Features of a recording's sound: onset rows for tokens, MFCC windows for frames, onset times.

What concerns onsets is librosa's; the cepstra are those of python_speech_features.
"""

import functools
import os
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from types import ModuleType
from typing import Any

import numpy as np
import soxr
from filelock import FileLock
from numpy.typing import NDArray

from data_prep.files import numba_cache
from data_prep.rates import (
    SAMPLE_RATE,
    SAMPLES_PER_FRAME,
    SAMPLES_PER_TOKEN,
    frames_covering,
    tokens_covering,
)
from data_prep.speech.beats import beats

ONSET_SIZE = 426
"""Columns: MFCC 20, their deltas 20, onset strength 1, beat 1, tempogram 384."""

MFCC_ROWS = 28
"""MFCC frames in the window of one video frame: seven video frames of four."""

MFCC_COLUMNS = 12
_FFT = 2048
_HOP = 512
_ONSET_RATE = SAMPLE_RATE * _HOP // SAMPLES_PER_TOKEN
"""1600 Hz, at which librosa's usual hop of 512 gives one row a token."""

_BPM = 120.0
"""Beats a minute that are likeliest before a recording is heard."""

_MFCCS = 20
_MEDIAN = 31
"""Windows, and bands, over which the percussive part takes medians."""

_TEMPOGRAM = 384
_SHORTEST = 1.6
"""Seconds below which the onset recipe fails; shorter sound is mirrored up to it."""

_BLOCK = 1024
"""Rows computed at once, so that memory beside the result does not grow with the sound."""

_REACH = 24
"""Hops beyond a block that its percussive part depends on: medians of 31 windows of 4 hops."""

_FRAMES_AROUND = 3
"""Video frames before and after a frame that its MFCC window covers."""

WINDOW = SAMPLE_RATE * 25 // 1000
"""Samples of one cepstral window (25 ms)."""

MFCC_HOP = SAMPLE_RATE // 100
"""Samples from one cepstral window to the next (10 ms)."""

_MFCC_FFT = 512
_FILTERS = 26
_COEFFICIENTS = 13
_PRE_EMPHASIS = 0.97
_LIFTER = 22
_FLOOR = np.finfo(np.float64).eps


@functools.cache
def load_librosa() -> ModuleType:
    """Librosa, imported when first needed."""
    numba_cache()
    with _compiled_when_called():
        import librosa.feature
        import librosa.onset
    return librosa


@contextmanager
def _compiled_when_called() -> Iterator[None]:
    """Put off what numba compiles as soon as it is defined until it is called.

    Librosa defines some 30 loops in this way, of which two are used here: compiling them took half
    a minute when librosa was first imported, and loading them half a second ever after.
    """
    import numba

    kept = numba.guvectorize, numba.vectorize
    numba.guvectorize, numba.vectorize = (_later(decorator) for decorator in kept)
    try:
        yield
    finally:
        numba.guvectorize, numba.vectorize = kept


def _later(decorator: Callable[..., Any]) -> Callable[..., Any]:
    """A decorator with arguments, of which the function gets the use at its first call."""

    def with_arguments(*args: Any, **settings: Any) -> Callable[..., Any]:
        def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
            @functools.cache
            def made() -> Callable[..., Any]:
                with _in_turn():
                    return decorator(*args, **settings)(function)

            return functools.wraps(function)(lambda *given, **named: made()(*given, **named))

        return decorate

    return with_arguments


def _in_turn() -> AbstractContextManager[object]:
    """Processes do what is in this block one after the other.

    Numba keeps on disk what it compiles. Processes that compile a loop for several types at the
    same moment mix up its files, and then they and all later ones crash.
    """
    folder = os.environ.get("NUMBA_CACHE_DIR")
    if not folder:
        return nullcontext()
    os.makedirs(folder, exist_ok=True)
    return FileLock(os.path.join(folder, "librosa.lock"))


def onset_rows(samples: NDArray) -> NDArray:
    """Onset features, one row for each token (ANGIE, section 4.1).

    The composition is Bailando's music feature without chroma, computed by librosa on the
    recording resampled to 1600 Hz with a hop of 512: 20 MFCC of the mel spectrogram in dB relative
    to its maximum, their deltas of width 3, the onset strength of the percussive part (median over
    bands), its beats as a one-hot column, and its tempogram of width 384.

    Args:
        samples: `(N,)` float32 mono at 16 kHz.

    Returns:
        features `(S, 426)` float32.
    """
    librosa = load_librosa()
    tokens = tokens_covering(frames_covering(len(samples)))
    least = round(_SHORTEST * SAMPLE_RATE)
    if len(samples) < least:
        samples = np.pad(samples, (0, least - len(samples)), mode="reflect")
    slow = soxr.resample(samples, SAMPLE_RATE, _ONSET_RATE)
    level = librosa.power_to_db(_mel_power(slow, _ONSET_RATE), ref=np.max)
    mfcc = librosa.feature.mfcc(S=level, n_mfcc=_MFCCS)
    delta = librosa.feature.delta(mfcc, width=3)
    strength = _onset_strength(_percussive(slow), _ONSET_RATE, np.median)
    beat = np.zeros_like(strength)
    if strength.any():
        with np.errstate(divide="ignore"):  # the tempo of lag 0
            tempo = librosa.feature.tempo(
                onset_envelope=strength, sr=_ONSET_RATE, hop_length=_HOP, start_bpm=_BPM
            )
        beat[beats(strength, max(1, round(60 * _ONSET_RATE / _HOP / float(tempo[0]))))] = 1
    columns = [mfcc.T, delta.T, strength[:, None], beat[:, None], _tempogram(strength)]
    rows = np.concatenate(columns, axis=1, dtype=np.float32)[:tokens]
    return np.pad(rows, ((0, tokens - len(rows)), (0, 0)), mode="edge")


def _mel_power(samples: NDArray, rate: int) -> NDArray:
    """Power in 128 mel bands of windows centred on multiples of the hop, `(128, 1 + N // 512)`."""
    librosa = load_librosa()
    padded, count = np.pad(samples, _FFT // 2), 1 + len(samples) // _HOP
    blocks = [
        librosa.feature.melspectrogram(
            y=padded[first * _HOP : (min(first + _BLOCK, count) - 1) * _HOP + _FFT],
            sr=rate,
            n_fft=_FFT,
            hop_length=_HOP,
            center=False,
        )
        for first in range(0, count, _BLOCK)
    ]
    return np.concatenate(blocks, axis=1)


def _percussive(samples: NDArray) -> NDArray:
    """The percussive part of sound (Fitzgerald 2010), `(N,)` float32.

    What `librosa.effects.percussive` gives; that module imports scikit-learn, which takes as long
    as all the rest.
    """
    from scipy.ndimage import median_filter

    librosa = load_librosa()
    step, reach = _BLOCK * _HOP, _REACH * _HOP
    blocks = []
    for first in range(0, len(samples), step):
        begin = max(first - reach, 0)
        part = samples[begin : first + step + reach]
        level, phase = librosa.magphase(librosa.stft(part))
        steady, sudden = (median_filter(level, size) for size in ((1, _MEDIAN), (_MEDIAN, 1)))
        share = librosa.util.softmask(sudden, steady, power=2, split_zeros=True)
        part = _sound(level * share * phase, len(part))
        blocks.append(part[first - begin :][:step])
    return np.concatenate(blocks)


def _sound(spectra: NDArray, length: int) -> NDArray:
    """Sound `(length,)` float32 of `librosa.stft`'s `(1025, T)`, as `librosa.istft` gives it.

    That one's loops are compiled, for two seconds at the first run; they are no faster than these.
    """
    from scipy.fft import irfft
    from scipy.signal import get_window

    window = get_window("hann", _FFT)
    pieces = (window[:, None] * irfft(spectra, axis=0)).T
    total, weight = np.zeros((2, (len(pieces) - 1) * _HOP + _FFT), np.float32)
    for first, piece in zip(range(0, len(total), _HOP), pieces, strict=False):
        total[first : first + _FFT] += piece
        weight[first : first + _FFT] += window**2
    heard = slice(_FFT // 2, _FFT // 2 + length)
    return total[heard] / np.maximum(weight[heard], np.finfo(np.float32).tiny)


def _onset_strength(samples: NDArray, rate: int, over_bands: Callable[..., NDArray]) -> NDArray:
    """Rise of the level in dB from one window to the next, `(1 + N // 512,)` float32."""
    librosa = load_librosa()
    level = librosa.power_to_db(_mel_power(samples, rate))
    return librosa.onset.onset_strength(S=level, sr=rate, hop_length=_HOP, aggregate=over_bands)


def _tempogram(strength: NDArray) -> NDArray:
    """Local autocorrelation of the onset strength `(T,)`, `(T, 384)` float32, at most 1."""
    librosa = load_librosa()
    padded = np.pad(strength, _TEMPOGRAM // 2, mode="linear_ramp", end_values=0)
    blocks = [
        librosa.feature.tempogram(
            onset_envelope=padded[first : min(first + _BLOCK, len(strength)) + _TEMPOGRAM - 1],
            win_length=_TEMPOGRAM,
            center=False,
        ).T.astype(np.float32)
        for first in range(0, len(strength), _BLOCK)
    ]
    return np.concatenate(blocks)


def onset_times(samples: NDArray) -> NDArray:
    """Onsets of sounds in seconds, `(n,)` float32: librosa's detector at 16 kHz, hop 512."""
    librosa = load_librosa()
    strength = _onset_strength(samples, SAMPLE_RATE, np.mean)
    times = librosa.onset.onset_detect(
        onset_envelope=strength, sr=SAMPLE_RATE, hop_length=_HOP, units="time"
    )
    return times.astype(np.float32)


def mfcc_windows(samples: NDArray) -> NDArray:
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
    per_frame = SAMPLES_PER_FRAME // MFCC_HOP
    count, around = (frames + 2 * _FRAMES_AROUND) * per_frame, _FRAMES_AROUND * SAMPLES_PER_FRAME
    rows = cepstra(samples, count, around)[:, 1:].astype(np.float32)
    windows = np.lib.stride_tricks.sliding_window_view(rows, MFCC_ROWS, axis=0, writeable=True)
    return windows[::per_frame].transpose(0, 2, 1)


@functools.cache
def mel_filters() -> NDArray:
    """Triangles `(_FILTERS, _MFCC_FFT // 2 + 1)` between equally spaced points of the mel scale."""
    top = 2595 * np.log10(1 + SAMPLE_RATE / 2 / 700)
    hertz = 700 * (10 ** (np.linspace(0, top, _FILTERS + 2) / 2595) - 1)
    left, centre, right = (
        np.floor((_MFCC_FFT + 1) * hertz / SAMPLE_RATE)[i : i + _FILTERS, None] for i in range(3)
    )
    bins = np.arange(_MFCC_FFT // 2 + 1)
    rising = (bins - left) / np.maximum(centre - left, 1)
    falling = (right - bins) / np.maximum(right - centre, 1)
    return np.where(bins < centre, rising, falling) * ((bins >= left) & (bins < right))


def cepstra(samples: NDArray, count: int, around: int = 0) -> NDArray:
    """Cepstra with the log energy in the place of the first coefficient.

    The definition is that of the package python_speech_features with a step of 10 ms:
    pre-emphasis 0.97, rectangular windows of 25 ms, 512-point power spectrum, 26 mel filters
    from 0 Hz to the Nyquist frequency, logarithm, orthonormal DCT-II, lifter 22.

    Args:
        samples: `(N,)` mono at 16 kHz in [-1, 1].
        count: windows wanted; the samples are continued by zeros.
        around: zeros before and after the samples, to which the pre-emphasis reaches.

    Returns:
        cepstra `(count, 13)` float64; row i is of `[MFCC_HOP i, MFCC_HOP i + WINDOW)`, counted
        from the first of these zeros.
    """
    samples = np.asarray(samples)
    blocks = [
        _cepstra(samples, MFCC_HOP * first - around, min(_BLOCK, count - first), min(around, 1))
        for first in range(0, count, _BLOCK)
    ]
    return np.concatenate(blocks) if blocks else np.zeros((0, _COEFFICIENTS))


def _cepstra(samples: NDArray, begin: int, count: int, after: int) -> NDArray:
    """Cepstra of `count` windows, the first at sample `begin`, which may be before the sound."""
    from scipy.fft import dct

    needed = (count - 1) * MFCC_HOP + WINDOW
    heard = samples[max(begin - 1, 0) : max(begin + needed, 0)].astype(np.float64)
    heard = np.pad(heard, (min(max(1 - begin, 0), needed + 1), after))  # from begin - 1 on
    shaped = (heard[1:] - _PRE_EMPHASIS * heard[:-1])[:needed]
    shaped = np.pad(shaped, (0, needed - len(shaped)))
    windows = np.lib.stride_tricks.sliding_window_view(shaped, WINDOW)[::MFCC_HOP]
    power = np.abs(np.fft.rfft(windows, _MFCC_FFT)) ** 2 / _MFCC_FFT  # (count, 257)
    energy = np.maximum(power.sum(axis=1), _FLOOR)
    bands = np.maximum(power @ mel_filters().T, _FLOOR)
    result = dct(np.log(bands), type=2, axis=1, norm="ortho")[:, :_COEFFICIENTS]
    order = np.arange(_COEFFICIENTS)
    result *= 1 + _LIFTER / 2 * np.sin(np.pi * order / _LIFTER)
    result[:, 0] = np.log(energy)
    return result
