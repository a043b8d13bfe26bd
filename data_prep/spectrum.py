"""Short-time spectra, mel bands and decibels, by librosa's conventions."""

import functools
from collections.abc import Iterable

import numpy as np
from scipy import fft
from scipy.ndimage import median_filter

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
