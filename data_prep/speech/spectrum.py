"""Short-time spectra, mel bands and decibels, by librosa's conventions.

Mel-frequency cepstra of speech, 100 a second.
"""

import functools
from collections.abc import Iterable

import numpy as np
from scipy import fft
from scipy.fft import dct
from scipy.ndimage import median_filter

from data_prep.rates import SAMPLE_RATE

FFT = 2048
"""Samples of one analysis window."""


HOP = 512
"""Samples from the middle of one window to the next."""


BANDS = 128
"""Mel bands from 0 Hz to the Nyquist frequency."""


_BLOCK = 512
"""Windows computed at once, so that memory beside the result does not grow with the sound."""


_MEDIAN = 31


_AMIN = 1e-10


_RANGE_DB = 80.0


@functools.cache
def hann(length: int) -> np.ndarray:
    """Periodic Hann window `(length,)` float32."""
    turns = np.arange(length) / length
    return (0.5 - 0.5 * np.cos(2 * np.pi * turns)).astype(np.float32)


def _mel(hertz: np.ndarray) -> np.ndarray:
    """Slaney's mel scale: linear to 1 kHz, 27 steps for each factor of 6.4 above."""
    above = 15 + 27 * np.log(np.maximum(hertz, 1000) / 1000) / np.log(6.4)
    return np.where(hertz < 1000, hertz * 3 / 200, above)


def _hertz(mel: np.ndarray) -> np.ndarray:
    return np.where(mel < 15, mel * 200 / 3, 1000 * 6.4 ** ((np.maximum(mel, 15) - 15) / 27))


@functools.cache
def mel_filters(rate: int) -> np.ndarray:
    """Triangles of unit area `(BANDS, FFT // 2 + 1)` float32 for a sample rate."""
    top = _mel(np.array(rate / 2))
    edges = _hertz(np.linspace(0, top, BANDS + 2))[:, None]
    bins = np.linspace(0, rate / 2, FFT // 2 + 1)
    left, centre, right = edges[:-2], edges[1:-1], edges[2:]
    triangles = np.minimum((bins - left) / (centre - left), (right - bins) / (right - centre))
    return (np.maximum(triangles, 0) * 2 / (right - left)).astype(np.float32)


def _windows(samples: np.ndarray) -> np.ndarray:
    padded = np.pad(np.asarray(samples, np.float32), FFT // 2)
    return np.lib.stride_tricks.sliding_window_view(padded, FFT)[::HOP]


def overlap_add(parts: Iterable[np.ndarray], count: int, length: int) -> np.ndarray:
    """Samples `(length,)` float32 whose spectra come nearest to the given ones.

    Args:
        parts: spectra `(n, FFT // 2 + 1)` of consecutive windows centred on multiples of HOP.
        count: windows in all parts together.
        length: samples wanted.
    """
    total = np.zeros(FFT + HOP * (count - 1), np.float32)
    weight = np.zeros_like(total)
    first = 0
    for spectra in parts:
        for pulse in fft.irfft(spectra, FFT, axis=1) * hann(FFT):
            total[first : first + FFT] += pulse
            weight[first : first + FFT] += hann(FFT) ** 2
            first += HOP
    covered = weight > np.finfo(np.float32).tiny
    total[covered] /= weight[covered]
    samples = total[FFT // 2 : FFT // 2 + length]
    return np.pad(samples, (0, length - len(samples)))


def mel_power(samples: np.ndarray, rate: int) -> np.ndarray:
    """Power in mel bands, `(1 + N // HOP, BANDS)` float32."""
    windows, filters = _windows(samples), mel_filters(rate).T
    blocks = []
    for start in range(0, len(windows), _BLOCK):
        spectra = fft.rfft(windows[start : start + _BLOCK] * hann(FFT), axis=1)
        blocks.append((spectra.real**2 + spectra.imag**2) @ filters)
    return np.concatenate(blocks)


def decibels(power: np.ndarray, reference: float = 1.0) -> np.ndarray:
    """Level of power over a reference, no more than 80 dB below the highest."""
    level = 10 * np.log10(np.maximum(power, _AMIN)) - 10 * np.log10(max(reference, _AMIN))
    return np.maximum(level, level.max() - _RANGE_DB)


def percussive(samples: np.ndarray) -> np.ndarray:
    """The percussive part of sound by median filtering (Fitzgerald 2010), `(N,)` float32.

    Medians over 31 windows keep what lasts, medians over 31 bins what is sudden; a soft mask
    of their squares divides each spectrum between the two.
    """
    windows = _windows(samples)
    parts = (_percussive(windows, first) for first in range(0, len(windows), _BLOCK))
    return overlap_add(parts, len(windows), len(samples))


def _percussive(windows: np.ndarray, first: int) -> np.ndarray:
    """Percussive spectra of a block of windows, seen with those that the medians reach."""
    begin = max(0, first - _MEDIAN // 2)
    seen = windows[begin : first + _BLOCK + _MEDIAN // 2]
    spectra = fft.rfft(seen * hann(FFT), axis=1)
    magnitude = np.abs(spectra)
    lasting = median_filter(magnitude, size=(_MEDIAN, 1), mode="reflect").astype(np.float64)
    sudden = median_filter(magnitude, size=(1, _MEDIAN), mode="reflect").astype(np.float64)
    whole = lasting**2 + sudden**2
    silent = np.maximum(lasting, sudden) < np.finfo(np.float32).tiny
    share = np.where(silent, 0.5, sudden**2 / np.where(silent, 1.0, whole))
    return (spectra * share.astype(np.float32))[first - begin :][:_BLOCK]


WINDOW = SAMPLE_RATE * 25 // 1000
"""Samples of one analysis window (25 ms)."""


MFCC_HOP = SAMPLE_RATE // 100
"""Samples from one window to the next (10 ms)."""


_MFCC_BLOCK = 1024
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
        cepstra `(count, 13)` float64; row i is of `[MFCC_HOP i, MFCC_HOP i + WINDOW)`, counted
        from the first of these zeros.
    """
    samples = np.asarray(samples)
    blocks = [
        _cepstra(
            samples, MFCC_HOP * first - around, min(_MFCC_BLOCK, count - first), min(around, 1)
        )
        for first in range(0, count, _MFCC_BLOCK)
    ]
    return np.concatenate(blocks) if blocks else np.zeros((0, _COEFFICIENTS))


def _cepstra(samples: np.ndarray, begin: int, count: int, after: int) -> np.ndarray:
    """Cepstra of `count` windows, the first at sample `begin`, which may be before the sound."""
    needed = (count - 1) * MFCC_HOP + WINDOW
    heard = samples[max(begin - 1, 0) : max(begin + needed, 0)].astype(np.float64)
    heard = np.pad(heard, (min(max(1 - begin, 0), needed + 1), after))  # from begin - 1 on
    shaped = (heard[1:] - _PRE_EMPHASIS * heard[:-1])[:needed]
    shaped = np.pad(shaped, (0, needed - len(shaped)))
    windows = np.lib.stride_tricks.sliding_window_view(shaped, WINDOW)[::MFCC_HOP]
    power = np.abs(np.fft.rfft(windows, _FFT)) ** 2 / _FFT  # (count, 257)
    energy = np.maximum(power.sum(axis=1), _FLOOR)
    bands = np.maximum(power @ _mel_filters().T, _FLOOR)
    result = dct(np.log(bands), type=2, axis=1, norm="ortho")[:, :_COEFFICIENTS]
    order = np.arange(_COEFFICIENTS)
    result = result * (1 + _LIFTER / 2 * np.sin(np.pi * order / _LIFTER))
    result[:, 0] = np.log(energy)
    return result
