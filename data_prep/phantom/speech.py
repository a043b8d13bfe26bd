"""Speech of the phantom: samples, word times, stressed syllables and the mouth.

A formant synthesiser after Klatt, "Software for a cascade/parallel formant synthesizer" (1980):
voicing and aspiration pass seven formants in cascade, frication passes two resonators of its own.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.signal import lfilter, sosfilt

from data_prep.phantom.phones import Segment, segments
from data_prep.phantom.presenters import Voice
from data_prep.phantom.script import LEXICON, Phrase
from data_prep.rates import FPS

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

    The glottal flow's derivative is the polynomial 2x - 3x^2 over the open phase (KLGLOTT88, Klatt
    and Klatt 1990), with jitter and shimmer of one and three per cent times the voice's roughness.
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
    upper = np.tile(_UPPER, (len(controls.pitch), 1))
    frequency = np.concatenate([controls.formants, upper], 1) * voice.formants
    narrow = np.array([60.0, 80.0, 130.0, 220.0, 300.0, 500.0, 700.0])
    sections = _resonators(_finer(frequency), _finer(narrow * controls.broad[:, None]))
    speech = _filtered(excited, sections)
    rasp = _filtered(
        rng.standard_normal(count) * _upsampled(controls.friction),
        _bandpass(np.tile(controls.noise[:, :1], 2), np.tile(1.5 * controls.noise[:, 1:], 2)),
    )
    return (speech + 2.2 * rasp).astype(np.float32)


_PACE = 0.76
"""Speed of a voice of rate 1 over that of the phones' own durations."""

ROOM = 0.0004
"""Level of the room's noise."""

_APART = 0.18
"""Seconds between syllables that movement can keep up with."""

LEAD = 0.6
"""Seconds of silence before the first word."""


@dataclass(frozen=True)
class Word:
    """A word as it was said; times in seconds."""

    word: str
    start: float
    end: float
    nuclei: tuple[float, ...]  # onsets of its vowels
    beats: tuple[float, ...]  # onsets of its stressed vowels
    phrase: int


@dataclass(frozen=True)
class Speech:
    """A recording with what is known about it."""

    samples: NDArray[np.float32]  # (N,) mono in [-1, 1]
    rate: int
    words: list[Word]
    opening: NDArray[np.float32]  # (C,) of the mouth at CONTROL a second, 0 to 1
    spread: NDArray[np.float32]  # (C,) of the lips, 0 rounded to 1 spread

    @property
    def duration(self) -> float:
        """Seconds."""
        return len(self.samples) / self.rate

    @property
    def beats(self) -> NDArray[np.float64]:
        """Onsets (n,) of all stressed vowels, seconds."""
        return np.array([beat for word in self.words for beat in word.beats])

    @property
    def nuclei(self) -> NDArray[np.float64]:
        """Onsets (m,) of all vowels, seconds."""
        return np.array([nucleus for word in self.words for nucleus in word.nuclei])

    @cached_property
    def pulse(self) -> NDArray[np.float64]:
        """Onsets (k,) of the vowels that movement keeps time with, seconds.

        All stressed ones, and those others that are `_APART` from every vowel that is kept.
        """
        kept = self.beats.tolist()
        for nucleus in self.nuclei.tolist():
            if all(abs(other - nucleus) >= _APART for other in kept):
                kept.append(nucleus)
        return np.array(sorted(kept))

    @property
    def phrases(self) -> list[tuple[float, float]]:
        """Start and end of each phrase, seconds."""
        spans: dict[int, tuple[float, float]] = {}
        for word in self.words:
            start, _ = spans.get(word.phrase, (word.start, 0.0))
            spans[word.phrase] = (start, word.end)
        return [spans[key] for key in sorted(spans)]


def _phrase_segments(phrase: Phrase) -> list[list[Segment]]:
    out = []
    for index, word in enumerate(phrase.words):
        last = index == len(phrase.words) - 1
        after = None if last else LEXICON[phrase.words[index + 1]][0].rstrip("01")
        out.append(segments(LEXICON[word], after, 1.5 if last else 1.0))
    return out


def _timed(
    phrases: list[Phrase], voice: Voice
) -> tuple[list[Word], list[tuple[float, float, Segment]], float]:
    """Words, segments with their starts and ends, and the whole duration.

    Slow speech lengthens its vowels more than its consonants.
    """
    now, words, track = LEAD, [], []
    for number, phrase in enumerate(phrases):
        speed = _PACE * voice.rate * phrase.tempo
        for word, parts in zip(phrase.words, _phrase_segments(phrase), strict=True):
            start, nuclei, beats = now, [], []
            for part in parts:
                if part.nucleus:
                    nuclei.append(now)
                    beats += [now] if part.stress else []
                end = now + part.duration / (speed if part.vowel else speed**0.5)
                track.append((now, end, part))
                now = end
            words.append(Word(word, start, now, tuple(nuclei), tuple(beats), number))
        now += phrase.pause
    return words, track, now


def _pitch(
    words: list[Word], phrases: list[Phrase], voice: Voice, at: NDArray, rng: np.random.Generator
) -> NDArray:
    """Fundamental frequency (C,): declination, accents on stressed vowels, final fall."""
    semitones = np.zeros(len(at))
    for number, phrase in enumerate(phrases):
        mine = [word for word in words if word.phrase == number]
        start, end = mine[0].start, mine[-1].end
        inside = (at >= start - 0.1) & (at <= end + 0.1)
        share = np.clip((at - start) / max(end - start, 0.2), 0, 1)
        line = 2.0 - 4.5 * share
        tail = np.clip((at - (end - 0.28)) / 0.28, 0, 1)
        line = line + (-3.5 if phrase.final else 2.5) * tail**1.5
        for word in mine:
            for beat in word.beats:
                height = voice.span * float(rng.uniform(0.5, 1.1))
                line = line + height * np.exp(-0.5 * ((at - beat - 0.06) / 0.075) ** 2)
        semitones = np.where(inside, line, semitones)
    semitones = gaussian_filter1d(semitones, 0.02 * CONTROL)
    return voice.pitch * 2 ** (semitones / 12)


def _tracks(track: list[tuple[float, float, Segment]], count: int) -> dict[str, NDArray]:
    """Control tracks (count,) or (count, n), smoothed as articulators move."""
    at = (np.arange(count) + 0.5) / CONTROL
    starts, ends = np.array([(start, end) for start, end, _ in track]).T
    index = np.clip(np.searchsorted(starts, at, side="right") - 1, 0, len(track) - 1)
    parts = [part for *_, part in track]
    said = (at >= starts[0]) & (at < ends[index])
    share = np.clip((at - starts[index]) / (ends - starts)[index], 0, 1)
    first = np.array([p.start for p in parts], float)[index]
    second = np.array([p.end for p in parts], float)[index]
    names = ("voicing", "breath", "friction", "open", "spread", "broad")
    level = np.array([[getattr(p, name) for name in names] for p in parts], float)[index]
    level[~said, :4] = 0
    fast, slow = 0.006 * CONTROL, 0.016 * CONTROL
    return {
        "formants": gaussian_filter1d(first + (second - first) * share[:, None], slow, axis=0),
        "voicing": gaussian_filter1d(level[:, 0], fast),
        "breath": gaussian_filter1d(level[:, 1], fast),
        "friction": gaussian_filter1d(level[:, 2], 0.5 * fast),
        "open": gaussian_filter1d(level[:, 3], 2 * slow),
        "spread": gaussian_filter1d(level[:, 4], 2 * slow),
        "broad": gaussian_filter1d(level[:, 5], fast),
        "noise": np.array([p.noise for p in parts])[index],
    }


def whole_frames(duration: float) -> int:
    """Video frames that cover a duration in seconds."""
    return int(np.ceil(duration * FPS))


def speak(phrases: list[Phrase], voice: Voice, rng: np.random.Generator) -> Speech:
    """Say the phrases with a voice.

    Args:
        phrases: what to say; every word must be in the lexicon.
        voice: how it sounds.
        rng: source of randomness.

    Returns:
        Speech at `RATE`, a whole number of video frames long, peak at 0.8.
    """
    words, track, duration = _timed(phrases, voice)
    count = whole_frames(duration) * CONTROL // FPS
    at = (np.arange(count) + 0.5) / CONTROL
    tracks = _tracks(track, count)
    opening, spread = tracks.pop("open"), tracks.pop("spread")
    controls = Controls(pitch=_pitch(words, phrases, voice, at, rng), **tracks)
    samples = synthesise(controls, voice, rng)
    samples *= 0.8 / max(float(np.abs(samples).max()), 1e-6)
    samples += ROOM * rng.standard_normal(len(samples)).astype(np.float32)
    return Speech(samples, RATE, words, opening.astype(np.float32), spread.astype(np.float32))
