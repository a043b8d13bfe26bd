"""A formant synthesiser: a glottal source and noise through resonators in cascade.

After Klatt, "Software for a cascade/parallel formant synthesizer" (1980): voicing and aspiration
pass seven formants in cascade, frication passes two resonators of its own.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.signal import lfilter, sosfilt

from data_prep.phantom.presenters import Voice

RATE = 24_000
"""Samples a second of the synthetic speech."""

CONTROL = 200
"""Control frames a second."""

_FINER = 3
"""Settings of the formants for each control frame."""

_UPPER = np.array([3400.0, 4300.0, 5500.0, 7000.0])
"""Formants above the third, hertz, the same for every phone."""

_BLOCK = RATE // CONTROL


@dataclass(frozen=True)
class Controls:
    """What steers the synthesiser, C frames at `CONTROL` a second, arrays (C,) or (C, n)."""

    pitch: NDArray  # hertz
    voicing: NDArray
    breath: NDArray
    friction: NDArray
    noise: NDArray  # (C, 2) centre and bandwidth of frication, hertz
    formants: NDArray  # (C, 3) hertz
    broad: NDArray  # scales bandwidths


def _resonators(frequency: NDArray, bandwidth: NDArray) -> NDArray:
    """Second-order sections (..., 6) with unit gain at zero frequency (Klatt 1980, eq. 1-2)."""
    r = np.exp(-np.pi * bandwidth / RATE)
    b = 2 * r * np.cos(2 * np.pi * np.minimum(frequency, 0.47 * RATE) / RATE)
    c = -r * r
    zero, one = np.zeros_like(r), np.ones_like(r)
    return np.stack([1 - b - c, zero, zero, one, -b, -c], -1)


def _bandpass(frequency: NDArray, bandwidth: NDArray) -> NDArray:
    """Second-order sections (..., 6) that pass a band with about unit gain at its centre."""
    r = np.exp(-np.pi * bandwidth / RATE)
    b = 2 * r * np.cos(2 * np.pi * np.minimum(frequency, 0.47 * RATE) / RATE)
    gain = (1 - r * r) / 2
    zero, one = np.zeros_like(r), np.ones_like(r)
    return np.stack([gain, zero, -gain, one, -b, r * r], -1)


def _filtered(signal: NDArray, sections: NDArray) -> NDArray:
    """Filter a signal (N,) with sections (C, S, 6), each for N / C samples."""
    state = np.zeros((sections.shape[1], 2))
    out = np.empty_like(signal)
    block = len(signal) // len(sections)
    for index, section in enumerate(np.ascontiguousarray(sections)):
        span = slice(index * block, (index + 1) * block)
        out[span], state = sosfilt(section, signal[span], zi=state)
    return out


def _finer(track: NDArray) -> NDArray:
    """A track (C, n) at `_FINER` times the rate, so that a filter moves in small steps."""
    at = (np.arange(len(track) * _FINER) + 0.5) / _FINER - 0.5
    low = np.clip(at.astype(int), 0, max(len(track) - 2, 0))
    share = np.clip(at - low, 0, 1)[:, None]
    return track[low] * (1 - share) + track[np.minimum(low + 1, len(track) - 1)] * share


def _upsampled(track: NDArray) -> NDArray:
    at = np.arange(len(track) * _BLOCK) / _BLOCK
    return np.interp(at, np.arange(len(track)) + 0.5, track)


def synthesise(controls: Controls, voice: Voice, rng: np.random.Generator) -> NDArray[np.float32]:
    """Speech (C * RATE / CONTROL,) float32, not yet scaled.

    The glottal flow's derivative is the polynomial 2x - 3x^2 over the open phase (KLGLOTT88,
    Klatt and Klatt 1990), with jitter and shimmer of one and three per cent
    times the voice's roughness.
    """
    count = len(controls.pitch) * _BLOCK
    unsteady = gaussian_filter1d(rng.standard_normal(count), RATE / 150)
    jitter = 1 + 0.012 * voice.rough * np.sqrt(2 * np.sqrt(np.pi) * RATE / 150) * unsteady
    cycle = np.cumsum(_upsampled(controls.pitch) * jitter / RATE)
    phase = np.mod(cycle, 1)
    shimmer = 1 + 0.03 * voice.rough * rng.standard_normal(int(cycle[-1]) + 2)[cycle.astype(int)]
    quotient = 0.55 + 0.25 * (1 - voice.effort)
    x = np.minimum(phase / quotient, 1)
    flow = (2 * x - 3 * x * x) * (x < 1) * shimmer
    tilt = 0.75 * (1 - voice.effort)
    flow = lfilter([1 - tilt], [1, -tilt], flow)
    hiss = rng.standard_normal(count)
    voicing, breath = _upsampled(controls.voicing), _upsampled(controls.breath)
    excited = flow * voicing + hiss * (0.20 * breath + voice.breath * voicing * (phase < 0.6))
    scale = voice.formants
    upper = _UPPER * scale + np.zeros((len(controls.pitch), 1))
    frequency = np.concatenate([controls.formants * scale, upper], 1)
    narrow = np.array([60.0, 80.0, 130.0, 220.0, 300.0, 500.0, 700.0])
    sections = _resonators(_finer(frequency), _finer(narrow * controls.broad[:, None]))
    speech = _filtered(excited, sections)
    rasp = _filtered(
        rng.standard_normal(count) * _upsampled(controls.friction),
        _bandpass(np.tile(controls.noise[:, :1], 2), np.tile(1.5 * controls.noise[:, 1:], 2)),
    )
    return (speech + 2.2 * rasp).astype(np.float32)
