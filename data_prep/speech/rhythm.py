"""Onset strength, onsets, beats and tempogram, by librosa's definitions."""

from collections.abc import Callable

import numpy as np
from scipy import fft

from data_prep.speech.spectrum import FFT, HOP, decibels, hann, mel_power

_START_BPM = 120.0
_MAX_BPM = 320.0
_TEMPO_SECONDS = 8.0
_TIGHTNESS = 100.0
_ONSET_DELTA = 0.07


def onset_strength(
    samples: np.ndarray, rate: int, over_bands: Callable[..., np.ndarray] = np.mean
) -> np.ndarray:
    """Rise of the level in dB from one window to the next, `(1 + N // HOP,)` float32.

    Args:
        samples: `(N,)` mono.
        rate: samples a second.
        over_bands: `np.mean` or `np.median`, how the mel bands are joined.
    """
    level = decibels(mel_power(samples, rate))
    rise = over_bands(np.maximum(np.diff(level, axis=0), 0), axis=1)
    # One place for the difference; half a window because it hears the rise that early.
    late = np.pad(rise, (1 + FFT // (2 * HOP), 0))
    return late[: len(level)].astype(np.float32)


def tempogram(strength: np.ndarray, size: int) -> np.ndarray:
    """Local autocorrelation of the onset strength, largest value 1, `(T, size)` float32.

    Args:
        strength: `(T,)` onset strength.
        size: length of the Hann window and number of lags, even or odd.
    """
    padded = np.pad(strength, size // 2, mode="linear_ramp", end_values=0)
    windows = np.lib.stride_tricks.sliding_window_view(padded, size)[: len(strength)]
    length = fft.next_fast_len(2 * size - 1, real=True)
    spectra = fft.rfft(windows * hann(size), length, axis=1)
    power = spectra.real**2 + spectra.imag**2
    lags = fft.irfft(power, length, axis=1)[:, :size]
    highest = np.abs(lags).max(axis=1, keepdims=True)
    return lags / np.where(highest < np.finfo(np.float32).tiny, 1, highest)


def _frames_per_beat(strength: np.ndarray, rate: float) -> int:
    """Most likely beat period in frames, with a prior around 120 beats a minute."""
    size = int(_TEMPO_SECONDS * rate)
    mean = tempogram(strength, size).astype(np.float64).mean(axis=0)
    bpm = 60 * rate / np.arange(1, size)
    prior = -0.5 * np.log2(bpm / _START_BPM) ** 2
    prior[bpm >= _MAX_BPM] = -np.inf
    best = bpm[np.argmax(np.log1p(1e6 * mean[1:]) + prior)]
    return max(1, int(np.round(rate * 60 / best)))


def _chain(score: np.ndarray, period: int) -> tuple[np.ndarray, np.ndarray]:
    """For each frame the best sum of scores of beats up to it, and the beat before."""
    total = np.zeros(len(score))
    before = np.full(len(score), -1)
    begun = False
    threshold = 0.01 * score.max()
    nearest, farthest = max(1, int(np.round(period / 2))), 2 * period
    steps = np.arange(nearest, farthest + 1)
    penalty = _TIGHTNESS * (np.log(steps) - np.log(period)) ** 2
    for i in range(len(score)):
        reachable = steps[steps <= i]
        total[i] = score[i]
        if not len(reachable):
            continue
        sums = total[i - reachable] - penalty[: len(reachable)]
        best = int(np.argmax(sums))
        total[i] += sums[best]
        begun = begun or score[i] >= threshold
        if begun:
            before[i] = i - reachable[best]
    return total, before


def beats(strength: np.ndarray, rate: float) -> np.ndarray:
    """Beat frames `(n,)` int64 by dynamic programming (Ellis 2007).

    Args:
        strength: `(T,)` onset strength.
        rate: of the strength, in frames a second.
    """
    strength = np.asarray(strength, np.float64)
    if not strength.any():
        return np.zeros(0, np.int64)
    period = _frames_per_beat(strength, rate)
    even = strength / (strength.std(ddof=1) + np.finfo(np.float32).tiny)
    reach = np.arange(-period, period + 1)
    score = np.convolve(even, np.exp(-0.5 * (reach * 32 / period) ** 2), "same")[: len(even)]
    total, before = _chain(score, period)
    peaks = np.flatnonzero(
        (total > np.append(total[0], total[:-1])) & (total >= np.append(total[1:], total[-1]))
    )
    last = len(total) - 1
    if len(peaks):
        last = int(peaks[total[peaks] >= 0.5 * np.median(total[peaks])][-1])
    found = []
    while last >= 0:
        found.append(last)
        last = int(before[last])
    return _trim(np.array(found[::-1]), score)


def _trim(found: np.ndarray, score: np.ndarray) -> np.ndarray:
    """Leave out beats before and after the part of the sound that is strong."""
    smooth = np.convolve(score[found], np.hanning(5))[2 : len(score) + 2]
    strong = np.flatnonzero(score > 0.5 * np.sqrt(np.mean(smooth**2)))
    if not len(strong):
        return found[:0]
    return found[(found >= strong[0]) & (found <= strong[-1])]


def onsets(strength: np.ndarray, rate: float) -> np.ndarray:
    """Onset frames `(n,)` int64: the strength stands out from 0.1 s on both sides.

    Args:
        strength: `(T,)` onset strength.
        rate: of the strength, in frames a second, below 33, where no two frames are so near
            that a higher neighbour would be the better onset.
    """
    high = strength.max(initial=0) - strength.min(initial=0)
    if not high > 0:
        return np.zeros(0, np.int64)
    scaled = (np.asarray(strength, np.float64) - strength.min()) / high
    reach = int(0.1 * rate)
    total = np.concatenate([[0.0], np.cumsum(scaled)])
    place = np.arange(len(scaled))
    left, right = np.maximum(place - reach, 0), np.minimum(place + reach + 1, len(scaled))
    mean = (total[right] - total[left]) / (right - left)
    return np.flatnonzero(scaled >= mean + _ONSET_DELTA)
