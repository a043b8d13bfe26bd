"""Transcripts that lie beside a video: found by their names, read whatever their format.

Word times from plain text and the sound: voiced time is shared out by syllables.
"""

import json
import math
import re
import unicodedata
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from data_prep.errors import BadInput
from data_prep.media.container import check_file, describe
from data_prep.rates import SAMPLE_RATE
from data_prep.speech.words import (
    Cue,
    Word,
    label,
    plain_text,
    read_captions,
    read_textgrid,
    spoken,
    spread,
)
from data_prep.table import decode_text

HOP = SAMPLE_RATE // 100
"""Samples of one step of the voice detector, 10 ms."""

SHORTEST = 10
"""Steps, 0.1 s: a shorter voiced stretch is noise, a shorter pause belongs to the voice."""

LIFT = 0.15
"""Threshold above the noise floor, in parts of the way to the loud steps."""

_FLOOR, _LOUD = 10, 95
"""Percentiles of the level that stand for the noise floor and for loud speech."""

_REACH = 1.0
"""Seconds of voiced time by which a phrase's end is moved to meet a pause."""

_VOWELS = re.compile(r"[aeiouyаеёиоуыэюяєіїαεηιουω]+")
_PHRASE_END = re.compile(r"[.,;:!?…][\"'”’)]*$")


def voiced(samples: np.ndarray) -> list[tuple[float, float]]:
    """Stretches of a recording in which somebody speaks.

    The level (RMS over 10 ms) must exceed `floor + 0.15 (p95 - floor)`; the floor is its 10th
    percentile. Pauses and stretches below 0.1 s are filled and dropped.

    Args:
        samples: `(N,)` mono at 16 kHz.

    Returns:
        start and end of each in seconds, in order.
    """
    from scipy.ndimage import binary_closing  # slow to import

    steps = len(samples) // HOP
    if not steps:
        return []
    power = np.square(samples[: steps * HOP], dtype=np.float64).reshape(steps, HOP)
    level = np.sqrt(power.mean(axis=1))
    floor, loud = np.percentile(level, (_FLOOR, _LOUD))
    active = level > floor + LIFT * (loud - floor)
    padded = np.pad(active, SHORTEST)
    active = binary_closing(padded, np.ones(SHORTEST))[SHORTEST:-SHORTEST]
    edges = np.flatnonzero(np.diff(np.pad(active.astype(np.int8), 1)))
    pairs = zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    return [(a * 0.01, b * 0.01) for a, b in pairs if b - a >= SHORTEST]


def syllables(word: str) -> int:
    """Estimated syllables of a word: its groups of vowels, at least one."""
    bare = unicodedata.normalize("NFKD", word.lower())
    bare = "".join(c for c in bare if not unicodedata.combining(c))
    return max(1, len(_VOWELS.findall(bare)))


def align(text: str, samples: np.ndarray) -> list[Word]:
    """Estimate when the words of a text are spoken.

    Voiced time is shared out in proportion to the syllables; where the text has a
    punctuation mark, the boundary moves to the nearest pause (within a second).

    Args:
        text: all that is said, in order.
        samples: `(N,)` mono at 16 kHz.

    Returns:
        words with times in seconds from the first sample; none where nothing is heard.
    """
    stretches = voiced(samples)
    words = spoken(text)
    if not stretches or not words:
        return []
    lengths = np.array([end - start for start, end in stretches])
    pauses = np.cumsum(lengths)  # the end of each stretch, in voiced time
    counts = np.array([syllables(word) for word in words], dtype=float)
    ends = np.cumsum(counts) / counts.sum() * pauses[-1]
    bounds = _to_pauses(ends, words, pauses)
    return [
        Word(word, *_real_time(start, end, stretches, pauses))
        for word, (start, end) in zip(words, pairwise([0.0, *bounds]), strict=True)
    ]


def _to_pauses(ends: np.ndarray, words: list[str], pauses: np.ndarray) -> list[float]:
    """Move the ends of phrases to pauses, and what lies between them in proportion."""
    knots, moved = [0.0], [0.0]
    for end, word in zip(ends[:-1].tolist(), words[:-1], strict=True):
        if not _PHRASE_END.search(word) or len(pauses) < 2:
            continue
        nearest = float(pauses[np.argmin(np.abs(pauses[:-1] - end))])
        if abs(nearest - end) <= _REACH and nearest > moved[-1]:
            knots.append(end)
            moved.append(nearest)
    knots.append(float(pauses[-1]))
    moved.append(float(pauses[-1]))
    return np.interp(ends, knots, moved).tolist()


def _real_time(
    start: float, end: float, stretches: list[tuple[float, float]], pauses: np.ndarray
) -> tuple[float, float]:
    """Voiced time to real time; a word across a pause stays on the side where more of it is."""
    middle = (start + end) / 2
    index = min(int(np.searchsorted(pauses, middle, side="right")), len(stretches) - 1)
    first = pauses[index - 1] if index else 0.0
    low, high = stretches[index]
    return (
        round(float(max(low, low + start - first)), 3),
        round(float(min(high, low + end - first)), 3),
    )


ENDINGS = ("words.json", "TextGrid", "ctm", "json", "vtt", "srt", "fragments.json", "txt")
"""Endings after a video's stem, best first; a language may stand before (`talk.en.vtt`)."""

_LANGUAGE = r"(?:[a-z]{2,3}(?:-[\w-]+)?\.)?"

_PROMPT = re.compile(r"\s*(\d+)\s+(\d+)\s+(?=\D)")
"""First and last sample, which corpora in TIMIT's style put before the text."""

_LISTS = ("words", "w", "segments", "fragments", "results", "result", "monologues", "elements")
_TEXTS = ("word", "text", "content", "value", "t", "lines", "transcript")
_STARTS = ("start", "begin", "startTime", "start_time", "b", "ts")
_ENDS = ("end", "endTime", "end_time", "e", "end_ts")
_LENGTHS = ("duration", "dur", "d")


@dataclass(frozen=True)
class Transcript:
    """Content of a transcript.

    Attributes:
        words: with times in seconds as the file counts them; empty where it has none.
        text: of a file without times, to be aligned with the sound.
        span: seconds of the sound that `text` covers, None for all of it.
    """

    words: list[Word]
    text: str = ""
    span: tuple[float, float] | None = None

    def aligned(self, samples: np.ndarray) -> list[Word]:
        """The words, timed by the sound where the file has no times.

        Args:
            samples: `(N,)` mono at 16 kHz from the beginning of the sound.
        """
        if not self.text:
            return self.words
        start, end = self.span or (0.0, len(samples) / SAMPLE_RATE)
        part = samples[round(start * SAMPLE_RATE) : round(end * SAMPLE_RATE)]
        return [Word(w.word, w.start + start, w.end + start) for w in align(self.text, part)]


def find_transcript(video: Path) -> Path | None:
    """The best transcript beside a video: a file of the same stem with one of `ENDINGS`."""
    video = Path(video)
    best: tuple[int, str] | None = None
    for name in sorted(path.name for path in video.parent.iterdir()):
        if not name.startswith(video.stem + "."):
            continue
        rest = name[len(video.stem) + 1 :]
        for rank, ending in enumerate(ENDINGS):
            if re.fullmatch(_LANGUAGE + re.escape(ending), rest, re.IGNORECASE):
                best = min(best or (rank, name), (rank, name))
                break
    return None if best is None else video.parent / best[1]


def read_transcript(path: Path) -> Transcript:
    """Read a transcript; its format follows from the name.

    JSON of word times (a list of words or of segments, and what Whisper, Vosk, PocketSphinx,
    Gentle and aeneas write), Praat TextGrid, CTM, SRT, WebVTT, or plain text. In cues of many
    words the time is shared out by their lengths.

    Raises:
        BadInput: not readable, not of that format, or without a word.
    """
    path = Path(path)
    check_file(path)
    try:
        transcript = _parse(decode_text(path.read_bytes()), path.suffix.lower())
        lost = [w.word for w in transcript.words if not math.isfinite(w.start + w.end)]
        if lost:
            raise ValueError(f"no time for {lost[0][:40]!r}")
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        raise BadInput(
            f"{path}: cannot be read as a transcript ({describe(error)}); correct it"
        ) from error
    if not transcript.words and not transcript.text:
        raise BadInput(f"{path}: holds no words; correct or remove it")
    return transcript


def _parse(text: str, suffix: str) -> Transcript:
    if suffix == ".json":
        return Transcript(spread(list(_json_cues(json.loads(text)))))
    if suffix == ".textgrid":
        return Transcript(spread(read_textgrid(text)))
    if suffix == ".ctm":
        return Transcript(spread(list(_ctm_cues(text))))
    if suffix in (".srt", ".vtt"):
        return Transcript(spread(read_captions(text)))
    prompt = _PROMPT.match(text)
    if prompt and int(prompt[2]) - int(prompt[1]) >= SAMPLE_RATE // 10:
        span = (int(prompt[1]) / SAMPLE_RATE, int(prompt[2]) / SAMPLE_RATE)
        return Transcript([], plain_text(text[prompt.end() :]), span)
    return Transcript([], plain_text(text))


def _ctm_cues(text: str) -> Iterator[Cue]:
    """Lines of `name channel start duration word [confidence]`."""
    for line in text.splitlines():
        if not line.strip() or line.startswith((";;", "#")):
            continue
        parts = line.split()
        if len(parts) < 5:
            raise ValueError(f"line {line[:40]!r} has fewer than five fields")
        if label(parts[4]):
            start = float(parts[2])
            yield Cue(start, start + float(parts[3]), label(parts[4]))


def _first(entry: dict[str, Any], names: tuple[str, ...]) -> Any:
    return next((entry[name] for name in names if entry.get(name) not in (None, "")), None)


def _json_cues(node: Any) -> Iterator[Cue]:
    """The finest entries of a JSON file that have a text and times."""
    if isinstance(node, list):
        for entry in node:
            yield from _json_cues(entry)
        return
    if not isinstance(node, dict):
        raise ValueError(f"no word with times, but {str(node)[:40]!r}")
    inner = next((node[name] for name in _LISTS if isinstance(node.get(name), list)), None)
    if inner:
        yield from _json_cues(inner)
        return
    text = _first(node, _TEXTS)
    text = label(" ".join(text) if isinstance(text, list) else str(text or ""))
    start, end, length = (_first(node, names) for names in (_STARTS, _ENDS, _LENGTHS))
    if start is None or (end is None and length is None):
        if text and "case" not in node:  # Gentle lists words that it did not find
            raise ValueError(f"no times for {text[:40]!r}")
        return
    if text:
        stop = float(end) if end is not None else float(start) + float(length)
        yield Cue(float(start), stop, text)
