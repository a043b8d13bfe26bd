"""Words with their times."""

import json
from dataclasses import dataclass
from pathlib import Path

from data_prep.errors import BadInput


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
    try:
        entries = json.loads(Path(path).read_text(encoding="utf-8"))
        words = [Word(str(e["word"]), float(e["start"]), float(e["end"])) for e in entries]
    except (OSError, ValueError, KeyError, TypeError) as error:
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
