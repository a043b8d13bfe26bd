"""Praat TextGrids, as forced aligners write them."""

import re
from collections.abc import Iterator

from data_prep.cues import Cue, label

_TOKEN = re.compile(r'"((?:[^"]|"")*)"|(?<!\S)([-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?)(?!\S)')
"""A quoted text or a number that stands alone; all else in the file is decoration."""


def _tokens(text: str) -> Iterator[str | float]:
    for match in _TOKEN.finditer(text):
        if match[2] is None:
            yield match[1].replace('""', '"')
        else:
            yield float(match[2])


def _number(tokens: Iterator[str | float]) -> float:
    token = next(tokens, None)
    if not isinstance(token, float):
        raise ValueError(f"a number is missing at {token!r}")
    return token


def _text(tokens: Iterator[str | float]) -> str:
    token = next(tokens, None)
    if not isinstance(token, str):
        raise ValueError(f"a text is missing at {token!r}")
    return token


def read_textgrid(text: str) -> list[Cue]:
    """Words of a TextGrid, long or short format: its tier named word, or its first of intervals.

    Raises:
        ValueError: damaged, or without a tier of intervals.
    """
    tokens = _tokens(text)
    if (_text(tokens), _text(tokens)) != ("ooTextFile", "TextGrid"):
        raise ValueError("no TextGrid")
    _number(tokens), _number(tokens)
    tiers: dict[str, list[Cue]] = {}
    for _ in range(int(_number(tokens))):
        kind, name = _text(tokens), _text(tokens)
        _number(tokens), _number(tokens)
        count = int(_number(tokens))
        if kind == "IntervalTier":
            cues = [Cue(_number(tokens), _number(tokens), _text(tokens)) for _ in range(count)]
            tiers.setdefault(name, cues)
        else:
            for _ in range(count):
                _number(tokens), _text(tokens)
    if not tiers:
        raise ValueError("no tier of intervals")
    named = [name for name in tiers if "word" in name.lower()]
    chosen = tiers[named[0]] if named else next(iter(tiers.values()))
    return [Cue(c.start, c.end, label(c.text)) for c in chosen if label(c.text)]
