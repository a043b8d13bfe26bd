"""Features of sound as it comes: a row for each token from at most 8 s before it and 0.3 s after.

What is computed for a moment depends neither on later sound nor on how long the recording is, so
that the same second has the same features in a sentence and in an hour, and live sound can have
them. They need no statistics: all columns lie within a few units of zero.
"""

import numpy as np
from numpy.typing import NDArray

from data_prep.rates import SAMPLES_PER_TOKEN, frames_covering, tokens_covering
from data_prep.speech.spectra import MFCC_HOP, WINDOW, mel_filters

PAST = 772
"""Hops of 10 ms before a token that its row sees: 7.7 s."""

AHEAD = 28
"""Hops of 10 ms from the beginning of a token on that its row sees; the last ends after 295 ms."""

STEP = 4
"""Hops of a step of the rhythm (25 a second)."""

LAGS = 50
"""Steps up to which the rhythm is compared with itself, 2 s."""

RECENT = 23
"""Last steps whose onset strength a row holds, 0.92 s: back to a token and a half before it."""

COEFFICIENTS = 13

ONSET_SIZE = 3 * COEFFICIENTS + RECENT + LAGS + 2
"""Columns: cepstra of three spans, onset strength, its autocorrelation, level and voice."""

VOICED = 0.15
"""Part of the way from the quiet to the loud level above which there is a voice."""

RANGE = 2.0
"""Least natural logarithm of power between quiet and loud (9 dB); below it nobody speaks."""

_HOPS = SAMPLES_PER_TOKEN // MFCC_HOP
_FLOOR = 1e-10
_FFT = 512
_BLOCK = 4096
_AT_ONCE = 64


def _log_bands(samples: NDArray, count: int) -> NDArray:
    """Logarithm of the power in 26 mel bands, (count, 26) float32, of windows of 25 ms every 10."""
    needed = (count - 1) * MFCC_HOP + WINDOW
    samples = np.pad(np.asarray(samples, np.float32)[:needed], (0, max(needed - len(samples), 0)))
    windows = np.lib.stride_tricks.sliding_window_view(samples, WINDOW)[::MFCC_HOP]
    parts = [
        np.log(np.abs(np.fft.rfft(windows[i : i + _BLOCK], _FFT)) ** 2 / _FFT @ mel_filters().T
               + _FLOOR).astype(np.float32)
        for i in range(0, count, _BLOCK)
    ]  # fmt: skip
    return np.concatenate(parts)


def _histories(samples: NDArray) -> NDArray:
    """Log bands (S, PAST + AHEAD, 26) that the rows of the tokens see; silence before the sound."""
    tokens = tokens_covering(frames_covering(len(samples)))
    bands = _log_bands(samples, (tokens - 1) * _HOPS + AHEAD)
    bands = np.concatenate([np.full((PAST, bands.shape[1]), np.log(_FLOOR), np.float32), bands])
    views = np.lib.stride_tricks.sliding_window_view(bands, PAST + AHEAD, axis=0)
    return views[::_HOPS].transpose(0, 2, 1)


def onset_rows_causal(samples: NDArray) -> NDArray:
    """Onset features of sound as it comes, one row for each token.

    Columns: 13 cepstra (DCT of log mel bands) of the token before, of the first half of what is
    heard ahead, and of the second, the loud level of the last 8 s taken away; the onset strength
    (mean rise of the log bands in 10 ms, the largest in 40 ms) of the last 0.92 s; its
    autocorrelation over the last 8 s at lags of 0.04 to 2 s; the level now against the loud and
    the quiet one; whether there is a voice.

    Args:
        samples: `(N,)` float32 mono at 16 kHz.

    Returns:
        rows `(S, 114)` float32; row s depends on sound from 8 s before the beginning of token s to
        0.3 s after it.
    """
    histories = _histories(samples)
    parts = [_rows(histories[i : i + _AT_ONCE], i) for i in range(0, len(histories), _AT_ONCE)]
    return np.concatenate(parts)


def voice_causal(samples: NDArray) -> NDArray:
    """Which tokens have a voice, `(S,)` float32 of 0 and 1, by the last 8 s and the next 0.3 s.

    A token is voiced where its level is above quiet + 0.15 (loud - quiet), the 5th and 95th
    percentile of the level heard so far in 8 s, and these lie 9 dB apart.
    """
    histories = _histories(samples)
    places = range(0, len(histories), _AT_ONCE)
    parts = [_levels(histories[i : i + _AT_ONCE], i)[2] for i in places]
    return np.concatenate(parts)


def _levels(bands: NDArray, first: int) -> tuple[NDArray, NDArray, NDArray]:
    """Loud level (n,), the level now between quiet 0 and loud 1 (n,), and voice (n,) float32.

    What lies before the recording counts as nothing, neither as silence nor as sound.

    Args:
        bands: histories (n, PAST + AHEAD, 26) of tokens.
        first: place of the first of these tokens.
    """
    level = bands.mean(-1)
    for row in range(min(len(level), max(0, -(-PAST // _HOPS) - first))):
        level[row, : PAST - (first + row) * _HOPS] = np.nan
    quantile = np.nanquantile if np.isnan(level).any() else np.quantile  # the latter is faster
    quiet, loud = quantile(level, [0.05, 0.95], axis=1)
    now = level[:, -AHEAD:].max(1)
    place = (now - quiet) / np.maximum(loud - quiet, RANGE)
    voiced = (place > VOICED) & (loud - quiet >= RANGE)
    return loud.astype(np.float32), place.astype(np.float32), voiced.astype(np.float32)


def _rows(bands: NDArray, first: int) -> NDArray:
    """Rows (n, 114) of histories (n, PAST + AHEAD, 26) of tokens from the place `first` on."""
    from scipy.fft import dct

    loud, place, voiced = _levels(bands, first)
    half = AHEAD // 2
    spans = [bands[:, -AHEAD - _HOPS : -AHEAD], bands[:, -AHEAD:-half], bands[:, -half:]]
    cepstra = []
    for span in spans:
        mean = span.mean(1) - loud[:, None]
        cepstra.append(dct(mean, type=2, axis=1, norm="ortho")[:, :COEFFICIENTS] / 5)
    rise = np.diff(bands, axis=1, prepend=bands[:, :1]).clip(0).mean(-1)  # (n, PAST + AHEAD)
    strength = rise.reshape(len(rise), -1, STEP).max(-1)  # (n, 200)
    centred = strength - strength.mean(1, keepdims=True)
    power = np.maximum((centred**2).sum(1), 1e-6)
    rhythm = [(centred[:, lag:] * centred[:, :-lag]).sum(1) / power for lag in range(1, LAGS + 1)]
    columns = [*cepstra, strength[:, -RECENT:], np.stack(rhythm, axis=1), place[:, None]]
    return np.concatenate([*columns, voiced[:, None]], axis=1).clip(-5, 5).astype(np.float32)
