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


def cepstra(samples: np.ndarray, count: int) -> np.ndarray:
    """Cepstra with the log energy in the place of the first coefficient.

    The definition is that of the package python_speech_features with a step of 10 ms:
    pre-emphasis 0.97, rectangular windows of 25 ms, 512-point power spectrum, 26 mel filters
    from 0 Hz to the Nyquist frequency, logarithm, orthonormal DCT-II, lifter 22.

    Args:
        samples: `(N,)` mono at 16 kHz in [-1, 1].
        count: windows wanted; the samples are continued by zeros.

    Returns:
        cepstra `(count, 13)` float64; row i is of samples `[HOP i, HOP i + WINDOW)`.
    """
    samples = np.asarray(samples)
    blocks = [
        _cepstra(samples, first, min(_BLOCK, count - first)) for first in range(0, count, _BLOCK)
    ]
    return np.concatenate(blocks) if blocks else np.zeros((0, _COEFFICIENTS))


def _cepstra(samples: np.ndarray, first: int, count: int) -> np.ndarray:
    """Cepstra of windows [first, first + count)."""
    begin, needed = first * HOP, (count - 1) * HOP + WINDOW
    heard = samples[begin : begin + needed].astype(np.float64)
    before = samples[max(begin - 1, 0) : max(begin - 1, 0) + len(heard)].astype(np.float64)
    if not begin and len(heard):
        before = np.append(0.0, before[:-1])  # the first sample has none before it
    shaped = heard - _PRE_EMPHASIS * before[: len(heard)]
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
