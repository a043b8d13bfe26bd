"""Subtitles: SRT and WebVTT, with the word times that automatic captions carry."""

import re

from data_prep.cues import Cue, plain_text

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
        ValueError: no line tells a time.
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
