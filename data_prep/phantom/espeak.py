"""The phantom's speech by eSpeak NG, where it is installed: the same words with clearer sound.

Words and phones are timed by the library; onsets of vowels are then moved to the nearest rise of
the sound. The library draws its noise from a state that it keeps, so only a fresh process says the
same twice: `python -m data_prep.phantom.espeak` reads a request as JSON and writes an npz.
"""

import ctypes
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
from data_prep.phantom.phones import DATA
from data_prep.phantom.presenters import Voice
from data_prep.phantom.script import LEXICON, Phrase
from data_prep.phantom.speech import CONTROL, LEAD, RATE, ROOM, Speech, Word, whole_frames
from data_prep.rates import FPS

_WORDS_A_MINUTE = 138
"""Speed of a voice of rate 1."""

_VOWELS = "aAeEiIoO0uUV3@"
"""First letters of the library's names of vowels."""

_NAMES = ("libespeak-ng.so.1", "libespeak-ng.so", "libespeak-ng.1.dylib", "libespeak-ng.dll")
_SYNCHRONOUS, _PHONEME_EVENTS, _UTF8 = 2, 1, 1
_RATE, _PITCH, _RANGE = 1, 3, 4
_WORD, _PHONEME = 1, 7


class _Name(ctypes.Union):
    _fields_ = [("number", ctypes.c_int), ("name", ctypes.c_char_p), ("string", ctypes.c_char * 8)]


class _Event(ctypes.Structure):
    _fields_ = [
        ("type", ctypes.c_int),
        ("unique_identifier", ctypes.c_uint),
        ("text_position", ctypes.c_int),
        ("length", ctypes.c_int),
        ("audio_position", ctypes.c_int),
        ("sample", ctypes.c_int),
        ("user_data", ctypes.c_void_p),
        ("id", _Name),
    ]


_CALLBACK = ctypes.CFUNCTYPE(
    ctypes.c_int, ctypes.POINTER(ctypes.c_short), ctypes.c_int, ctypes.POINTER(_Event)
)


def _load() -> ctypes.CDLL | None:
    """The library, None when it is not installed."""
    for name in _NAMES:
        try:
            return ctypes.CDLL(name)
        except OSError:
            continue
    return None


def _say(request: dict) -> dict[str, np.ndarray]:
    """Say phrases in this process, which must be a fresh one.

    Args:
        request: `voice`, `pitch`, `range` (0 to 99) and `phrases`, pairs of a text and its words a
            minute.

    Returns:
        `rate`; for each phrase i `samples_i` (N,) int16, `word_at_i` and `word_letter_i` (n,)
        sample and letter (from 1) of the beginning of words, `phone_at_i` (m,) and `phone_i` (m,)
        samples and names of phonemes.
    """
    library = _load()
    if library is None:
        raise OSError("libespeak-ng is not installed")
    rate = library.espeak_Initialize(_SYNCHRONOUS, 200, None, _PHONEME_EVENTS)
    if rate <= 0:
        raise OSError("libespeak-ng does not start: its data is missing")
    if library.espeak_SetVoiceByName(request["voice"].encode()) != 0:
        raise OSError(f"libespeak-ng has no voice {request['voice']}")
    sound: list[np.ndarray] = []
    words: list[tuple[int, int]] = []
    phones: list[tuple[int, bytes]] = []

    def take(wave, count, events) -> int:  # type: ignore[no-untyped-def]
        if count > 0:
            sound.append(np.ctypeslib.as_array(wave, (count,)).copy())
        index = 0
        while events[index].type:
            event = events[index]
            if event.type == _WORD:
                words.append((event.sample, event.text_position))
            elif event.type == _PHONEME:
                phones.append((event.sample, event.id.string))
            index += 1
        return 0

    keep = _CALLBACK(take)
    library.espeak_SetSynthCallback(keep)
    library.espeak_SetParameter(_PITCH, request["pitch"], 0)
    library.espeak_SetParameter(_RANGE, request["range"], 0)
    out = {"rate": np.array(rate)}
    for index, (text, pace) in enumerate(request["phrases"]):
        for found in (sound, words, phones):
            found.clear()
        library.espeak_SetParameter(_RATE, pace, 0)
        letters = text.encode() + b"\0"
        library.espeak_Synth(letters, len(letters), 0, 1, 0, _UTF8, None, None)
        library.espeak_Synchronize()
        out[f"samples_{index}"] = np.concatenate([*sound, np.zeros(0, np.int16)])
        out[f"word_at_{index}"] = np.array([at for at, _ in words], np.int64)
        out[f"word_letter_{index}"] = np.array([letter for _, letter in words], np.int64)
        out[f"phone_at_{index}"] = np.array([at for at, _ in phones], np.int64)
        out[f"phone_{index}"] = np.array([name.decode() for _, name in phones], "U8")
    return out


def installed() -> bool:
    """Whether the library can be loaded."""
    return _load() is not None


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
        [sys.executable, "-m", "data_prep.phantom.espeak"],
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
            opening[inside] = DATA["espeak"]["open"].get(name[:1], 0.15)
            spread[inside] = DATA["espeak"]["spread"].get(name[:1], 0.55)
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


def _main() -> None:
    """Answer one request."""
    answer = io.BytesIO()
    np.savez(answer, **_say(json.load(sys.stdin)))  # type: ignore[arg-type]
    sys.stdout.buffer.write(answer.getvalue())


if __name__ == "__main__":
    _main()
