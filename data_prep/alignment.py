"""Word times from a text and the sound alone: voiced time is shared out by syllables."""

import re
import unicodedata
from itertools import pairwise

import numpy as np
from scipy.ndimage import binary_closing

from data_prep.cues import spoken
from data_prep.rates import SAMPLE_RATE
from data_prep.words import Word

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
