"""Words with their times.

Cues: stretches of time with the text that is spoken in them, and their words.

Subtitles: SRT and WebVTT, with the word times that automatic captions carry.

Praat TextGrids, as forced aligners write them.
"""

import html
import json
import re
from dataclasses import dataclass
from pathlib import Path

from data_prep.errors import BadInput
from data_prep.media.container import check_file


@dataclass(frozen=True)
class Word:
    """A spoken word.

    Attributes:
        word: as written.
        start: seconds from the beginning of the sound.
        end: seconds from the beginning of the sound.
    """

    word: str
    start: float
    end: float


def read_words(path: Path) -> list[Word]:
    """Read word times from JSON: `[{"word": ..., "start": seconds, "end": seconds}, ...]`.

    Raises:
        BadInput: not such a file.
    """
    check_file(path)
    try:
        entries = json.loads(Path(path).read_bytes())
        words = [Word(str(e["word"]), float(e["start"]), float(e["end"])) for e in entries]
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise BadInput(
            f'{path}: is no list of {{"word", "start", "end"}}; correct or remove it'
        ) from error
    return sorted(words, key=lambda word: word.start)


def write_words(path: Path, words: list[Word]) -> None:
    """Write word times as `read_words` reads them, to a millisecond."""
    entries = [{"word": w.word, "start": round(w.start, 3), "end": round(w.end, 3)} for w in words]
    Path(path).write_text(json.dumps(entries, ensure_ascii=False, indent=0) + "\n", "utf-8")


def slice_words(words: list[Word], start: float, end: float) -> list[Word]:
    """Words whose middle lies in `[start, end)` seconds, with times from `start` on."""
    return [
        Word(w.word, max(w.start - start, 0.0), min(w.end, end) - start)
        for w in words
        if start <= (w.start + w.end) / 2 < end
    ]


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


_TIME = r"(?:(\d+):)?(\d{1,2}):(\d{1,2})[.,](\d{1,3})"
_LINE = re.compile(rf"\s*{_TIME}\s*-->\s*{_TIME}")
_STAMP = re.compile(rf"<{_TIME}>")

_INSTANT = 0.05
"""Automatic captions hold a line for such a moment before it rolls up."""


def _seconds(hours: str | None, minutes: str, seconds: str, fraction: str) -> float:
    return int(hours or 0) * 3600 + int(minutes) * 60 + int(seconds) + float(f"0.{fraction}")


def read_captions(text: str) -> list[Cue]:
    """Cues of an SRT or WebVTT file, those with word times a cue for each word.

    Where lines roll up, so that each is shown twice or more, it counts when it first appears.

    Raises:
        ValueError: no line has a time.
    """
    blocks = _blocks(text)
    if not blocks:
        raise ValueError("no line such as 00:00:01,000 --> 00:00:02,000")
    rolling = any(
        end - start < _INSTANT or _STAMP.search("".join(lines)) for start, end, lines in blocks
    )
    cues: list[Cue] = []
    before: list[str] = []
    for start, end, lines in blocks:
        new = [line for line in lines if not rolling or plain_text(line) not in before]
        before = [plain_text(line) for line in lines]
        cues += _timed(start, max(start, end), " ".join(new))
    return cues


def _blocks(text: str) -> list[tuple[float, float, list[str]]]:
    """Start, end and lines of text of each cue."""
    blocks: list[tuple[float, float, list[str]]] = []
    inside = False
    for line in text.splitlines():
        times = _LINE.match(line)
        if times:
            numbers = times.groups()
            blocks.append((_seconds(*numbers[:4]), _seconds(*numbers[4:]), []))
            inside = True
        elif line == "":  # automatic captions have lines of one space inside of cues
            inside = False
        elif inside and line.strip():
            blocks[-1][2].append(line)
    return blocks


def _timed(start: float, end: float, text: str) -> list[Cue]:
    """Cut a cue at the times that its text holds."""
    cues = []
    place, time = 0, start
    for stamp in _STAMP.finditer(text):
        then = min(max(_seconds(*stamp.groups()), time), end)
        cues.append(Cue(time, then, text[place : stamp.start()]))
        place, time = stamp.end(), then
    cues.append(Cue(time, end, text[place:]))
    return [cue for cue in cues if plain_text(cue.text)]


def read_textgrid(text: str) -> list[Cue]:
    """Words of a TextGrid, long or short format: its tier named word, or its first of intervals.

    Raises:
        ValueError: damaged, or without a tier of intervals.
    """
    from praatio.utilities import constants, errors, textgrid_io

    try:
        tiers = textgrid_io.parseTextgridStr(text)["tiers"]
    except (errors.PraatioException, LookupError, AttributeError, ValueError) as error:
        raise ValueError("no TextGrid, or a damaged one") from error
    tiers = [tier for tier in tiers if tier["class"] == constants.INTERVAL_TIER]
    if not tiers:
        raise ValueError("no tier of intervals")
    chosen = next((tier for tier in tiers if "word" in tier["name"].lower()), tiers[0])
    cues = [Cue(float(start), float(end), label(text)) for start, end, text in chosen["entries"]]
    return [cue for cue in cues if cue.text]
