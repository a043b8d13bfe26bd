"""The phantom's speech by eSpeak NG, where it is installed: the same words with clearer sound.

Words and phones are timed by the library; onsets of vowels are then moved to the nearest rise of
the sound.
"""

import io
import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import soxr
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from data_prep.errors import BadInput
from data_prep.phantom import espeak_library
from data_prep.phantom.presenters import Voice
from data_prep.phantom.script import LEXICON, Phrase
from data_prep.phantom.speech import CONTROL, LEAD, RATE, ROOM, Speech, Word, whole_frames
from data_prep.rates import FPS

_WORDS_A_MINUTE = 138
"""Speed of a voice of rate 1."""

_VOWELS = "aAeEiIoO0uUV3@"
"""First letters of the library's names of vowels."""

_OPEN = {
    "a": 1.0, "A": 1.0, "0": 0.85, "O": 0.8, "V": 0.75, "E": 0.7, "e": 0.6, "o": 0.6, "3": 0.45,
    "@": 0.4, "I": 0.4, "U": 0.4, "i": 0.25, "u": 0.25, "p": 0.0, "b": 0.0, "m": 0.0, "f": 0.08,
    "v": 0.08, "_": 0.0,
}  # fmt: skip
"""Opening of the mouth by the first letter of a phone, 0.15 for others."""

_SPREAD = {"i": 1.0, "I": 0.9, "e": 0.9, "E": 0.8, "a": 0.6, "o": 0.1, "O": 0.1, "u": 0.05,
           "U": 0.15, "w": 0.0, "r": 0.2}  # fmt: skip
"""Spread of the lips by the first letter of a phone, 0.55 for others."""


def installed() -> bool:
    """Whether the library can be loaded."""
    return espeak_library.load() is not None


@dataclass(frozen=True)
class _Said:
    """A phrase as the library said it, cut to where it sounds; times in seconds."""

    samples: NDArray[np.float64]  # at RATE
    word_at: NDArray[np.float64]
    word_letter: NDArray[np.int64]
    phone_at: NDArray[np.float64]
    phone: list[str]


def _request(phrases: list[Phrase], voice: Voice) -> dict:
    paces = [max(80, round(_WORDS_A_MINUTE * voice.rate * p.tempo)) for p in phrases]
    texts = [" ".join(phrase.words) for phrase in phrases]
    return {
        "voice": f"en-us+{voice.espeak}",
        "pitch": voice.espeak_pitch,
        "range": round(10 * voice.span),
        "phrases": list(zip(texts, paces, strict=True)),
    }


def _answer(request: dict) -> list[_Said]:
    root = str(Path(__file__).parents[2])
    paths = [root, *filter(None, [os.environ.get("PYTHONPATH")])]
    done = subprocess.run(
        [sys.executable, "-m", "data_prep.phantom.espeak_library"],
        input=json.dumps(request).encode(),
        capture_output=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
    )
    if done.returncode:
        reason = (done.stderr.decode(errors="replace").strip().splitlines() or ["no reason"])[-1]
        raise BadInput(f"espeak-ng: cannot speak ({reason}); use --voice builtin")
    said = []
    with np.load(io.BytesIO(done.stdout), allow_pickle=False) as found:
        rate = int(found["rate"])
        for index in range(len(request["phrases"])):
            samples = soxr.resample(
                found[f"samples_{index}"].astype(np.float64) / 32768, rate, RATE
            )
            phone_at, word_at = found[f"phone_at_{index}"] / rate, found[f"word_at_{index}"] / rate
            loud = np.flatnonzero(np.abs(samples) > 0.01 * np.abs(samples).max(initial=1e-9))
            first, last = int(loud[0]), int(loud[-1]) + 1
            start = first / RATE
            said.append(_Said(
                samples[first:last],
                np.maximum(word_at - start, 0),
                found[f"word_letter_{index}"],
                np.clip(phone_at - start, 0, (last - first) / RATE),
                found[f"phone_{index}"].tolist(),
            ))  # fmt: skip
    return said


def _risen(samples: NDArray, times: NDArray) -> NDArray:
    """Times (n,) moved to where the loudness rises most within 30 ms before and 50 ms after."""
    step = RATE // 500
    count = len(samples) // step
    power = (samples[: count * step].reshape(count, step) ** 2).mean(1)
    loud = np.sqrt(gaussian_filter1d(power, 3))
    rise = np.diff(loud, prepend=0)
    moved = []
    for time in times:
        first, last = max(int((time - 0.03) * 500), 0), min(int((time + 0.05) * 500) + 1, count)
        best = first + int(np.argmax(rise[first:last])) if last > first else int(time * 500)
        moved.append(best / 500)
    return np.maximum.accumulate(np.array(moved, float))


def _spans(phrase: Phrase, said: _Said) -> NDArray:
    """Starts of the words and the end of the last, (n + 1,) seconds.

    Words that the library runs together share their time by their letters.
    """
    letters = np.cumsum([0, *(len(word) + 1 for word in phrase.words)])
    known = {int(letter) - 1: float(at) for at, letter in
             zip(said.word_at, said.word_letter, strict=True)}  # fmt: skip
    at = [(letter, known[letter]) for letter in letters[:-1].tolist() if letter in known]
    if not at or at[0][0] != 0:
        at = [(0, 0.0), *at]
    at.append((int(letters[-1]), len(said.samples) / RATE))
    places, times = zip(*at, strict=True)
    return np.interp(letters, places, np.maximum.accumulate(times))


def _words(phrase: Phrase, said: _Said, number: int, now: float) -> list[Word]:
    spans = _spans(phrase, said)
    vowel = np.array([name[:1] in _VOWELS and name != "" for name in said.phone], bool)
    given = said.phone_at[vowel]
    risen = _risen(said.samples, given)
    words = []
    for index, word in enumerate(phrase.words):
        start, end = spans[index], spans[index + 1]
        mine = [float(min(max(r, start), end)) for g, r in zip(given, risen, strict=True)
                if start - 1e-3 <= g < end - 1e-3]  # fmt: skip
        vowels = [phone for phone in LEXICON[word] if phone[-1] in "01"]
        strong = [i for i, phone in enumerate(vowels) if phone.endswith("1")]
        beats = {mine[min(i, len(mine) - 1)] for i in strong} if mine else set()
        words.append(
            Word(
                word, now + start, now + end,
                tuple(now + m for m in mine), tuple(now + b for b in sorted(beats)), number,
            )
        )  # fmt: skip
    return words


def _mouth(said: list[_Said], at: list[float], count: int) -> tuple[NDArray, NDArray]:
    """Opening and spread of the mouth (count,) at CONTROL a second."""
    ticks = (np.arange(count) + 0.5) / CONTROL
    opening, spread = np.zeros(count), np.full(count, 0.55)
    for phrase, now in zip(said, at, strict=True):
        ends = np.append(phrase.phone_at[1:], len(phrase.samples) / RATE)
        for name, start, end in zip(phrase.phone, phrase.phone_at, ends, strict=True):
            inside = (ticks >= now + start) & (ticks < now + end)
            opening[inside] = _OPEN.get(name[:1], 0.15)
            spread[inside] = _SPREAD.get(name[:1], 0.55)
    smooth = 0.03 * CONTROL
    return gaussian_filter1d(opening, smooth), gaussian_filter1d(spread, smooth)


def speak(phrases: list[Phrase], voice: Voice, rng: np.random.Generator) -> Speech:
    """Say the phrases with eSpeak NG; see `speech.speak`.

    Raises:
        BadInput: it is not installed, or fails.
    """
    if not installed():
        raise BadInput("espeak-ng: not found; install the package espeak-ng or use --voice builtin")
    said = _answer(_request(phrases, voice))
    now, words, starts = LEAD, [], []
    for number, (phrase, part) in enumerate(zip(phrases, said, strict=True)):
        starts.append(now)
        words += _words(phrase, part, number, now)
        now += len(part.samples) / RATE + phrase.pause
    frames = whole_frames(now)
    count = frames * CONTROL // FPS
    samples = np.zeros(frames * RATE // FPS)
    for start, part in zip(starts, said, strict=True):
        first = round(start * RATE)
        samples[first : first + len(part.samples)] += part.samples
    samples *= 0.8 / max(float(np.abs(samples).max()), 1e-6)
    samples += ROOM * rng.standard_normal(len(samples))
    opening, spread = _mouth(said, starts, count)
    return Speech(samples.astype(np.float32), RATE, words,
                  opening.astype(np.float32), spread.astype(np.float32))  # fmt: skip
