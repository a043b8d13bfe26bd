"""Cues: stretches of time with the text that is spoken in them, and their words."""

import html
import re
from dataclasses import dataclass

from data_prep.words import Word

_MARKUP = re.compile(r"<[^>]*>|\{\\[^}]*\}|\[[^\]]*\]|\([^)]*\)|♪")
"""Tags, override codes, and what is no speech: [music], (applause)."""

_NOT_WORDS = frozenset({"sil", "sp", "spn", "nsn", "noi", "unk", "#"})
"""Labels by which aligners mark silence and noise; only where a cue is a single word."""

_VARIANT = re.compile(r"\(\d+\)$")


@dataclass(frozen=True)
class Cue:
    """Text and the time in which it is spoken.

    Attributes:
        start: seconds.
        end: seconds; before `start` it counts as `start`.
        text: one word or many.
    """

    start: float
    end: float
    text: str


def plain_text(text: str) -> str:
    """Text without markup and remarks, on one line."""
    return " ".join(_MARKUP.sub(" ", html.unescape(text)).split())


def spoken(text: str) -> list[str]:
    """The words of a text: parts between spaces that hold a letter or a digit."""
    return [part for part in plain_text(text).split() if any(c.isalnum() for c in part)]


def label(text: str) -> str:
    """A word as an aligner names it, without the number of its pronunciation; "" for silence."""
    word = plain_text(_VARIANT.sub("", text.strip()))
    return "" if word.lower() in _NOT_WORDS else word


def spread(cues: list[Cue]) -> list[Word]:
    """Words of cues in order of time; within a cue its time is shared out by their lengths.

    Args:
        cues: in any order.

    Returns:
        words that follow one another without a pause within a cue.
    """
    words: list[Word] = []
    for cue in cues:
        parts = spoken(cue.text)
        letters = [sum(c.isalnum() for c in part) for part in parts]
        rate = max(cue.end - cue.start, 0.0) / max(sum(letters), 1)
        time = cue.start
        for part, count in zip(parts, letters, strict=True):
            words.append(Word(part, time, time + count * rate))
            time += count * rate
    return sorted(words, key=lambda word: (word.start, word.end))
