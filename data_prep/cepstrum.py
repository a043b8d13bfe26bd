"""Mel-frequency cepstra of speech, 100 a second."""

import functools

import numpy as np
from scipy.fft import dct

from data_prep.rates import SAMPLE_RATE

WINDOW = SAMPLE_RATE * 25 // 1000
"""Samples of one analysis window (25 ms)."""

HOP = SAMPLE_RATE // 100
"""Samples from one window to the next (10 ms)."""

_BLOCK = 1024
"""Windows computed at once, so that memory beside the result does not grow with the sound."""

_FFT = 512
_FILTERS = 26
_COEFFICIENTS = 13
_PRE_EMPHASIS = 0.97
_LIFTER = 22
_FLOOR = np.finfo(np.float64).eps


@functools.cache
def _mel_filters() -> np.ndarray:
    """Triangles `(_FILTERS, _FFT // 2 + 1)` between equally spaced points of the mel scale."""
    top = 2595 * np.log10(1 + SAMPLE_RATE / 2 / 700)
    hertz = 700 * (10 ** (np.linspace(0, top, _FILTERS + 2) / 2595) - 1)
    left, centre, right = (
        np.floor((_FFT + 1) * hertz / SAMPLE_RATE)[i : i + _FILTERS, None] for i in range(3)
    )
    bins = np.arange(_FFT // 2 + 1)
    rising = (bins - left) / np.maximum(centre - left, 1)
    falling = (right - bins) / np.maximum(right - centre, 1)
    return np.where(bins < centre, rising, falling) * ((bins >= left) & (bins < right))


def cepstra(samples: np.ndarray, count: int, around: int = 0) -> np.ndarray:
    """Cepstra with the log energy in the place of the first coefficient.

    The definition is that of the package python_speech_features with a step of 10 ms:
    pre-emphasis 0.97, rectangular windows of 25 ms, 512-point power spectrum, 26 mel filters
    from 0 Hz to the Nyquist frequency, logarithm, orthonormal DCT-II, lifter 22.

    Args:
        samples: `(N,)` mono at 16 kHz in [-1, 1].
        count: windows wanted; the samples are continued by zeros.
        around: zeros before and after the samples, to which the pre-emphasis reaches.

    Returns:
        cepstra `(count, 13)` float64; row i is of `[HOP i, HOP i + WINDOW)`, counted from the
        first of these zeros.
    """
    samples = np.asarray(samples)
    blocks = [
        _cepstra(samples, HOP * first - around, min(_BLOCK, count - first), min(around, 1))
        for first in range(0, count, _BLOCK)
    ]
    return np.concatenate(blocks) if blocks else np.zeros((0, _COEFFICIENTS))


def _cepstra(samples: np.ndarray, begin: int, count: int, after: int) -> np.ndarray:
    """Cepstra of `count` windows, the first at sample `begin`, which may be before the sound."""
    needed = (count - 1) * HOP + WINDOW
    heard = samples[max(begin - 1, 0) : max(begin + needed, 0)].astype(np.float64)
    heard = np.pad(heard, (min(max(1 - begin, 0), needed + 1), after))  # from begin - 1 on
    shaped = (heard[1:] - _PRE_EMPHASIS * heard[:-1])[:needed]
    shaped = np.pad(shaped, (0, needed - len(shaped)))
    windows = np.lib.stride_tricks.sliding_window_view(shaped, WINDOW)[::HOP]
    power = np.abs(np.fft.rfft(windows, _FFT)) ** 2 / _FFT  # (count, 257)
    energy = np.maximum(power.sum(axis=1), _FLOOR)
    bands = np.maximum(power @ _mel_filters().T, _FLOOR)
    result = dct(np.log(bands), type=2, axis=1, norm="ortho")[:, :_COEFFICIENTS]
    order = np.arange(_COEFFICIENTS)
    result = result * (1 + _LIFTER / 2 * np.sin(np.pi * order / _LIFTER))
    result[:, 0] = np.log(energy)
    return result
