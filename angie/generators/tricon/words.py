"""Words as vectors: hashed parts of words, or vectors of a fastText file.

A word has a row of numbers of its parts, and its vector is the mean of the vectors of these parts.
Row 0 has no part and stands for a frame in which no word begins: its vector is zero.
"""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.functional import embedding

from data_prep.errors import BadInput
from data_prep.speech.words import Word

SHORTEST, LONGEST = 3, 6
"""Letters of the parts of a word, its borders among them (fastText's)."""

PARTS = 64
"""Parts of a word that count, at most."""

NONE = -1
"""Fills rows up."""


def plain(word: str) -> str:
    """A word as it is looked up: lower case, letters and . , ! ? alone; "" if nothing is left."""
    kept = "".join(c for c in word.lower() if c.isalpha() or c in ",.!?")
    return kept if any(c.isalpha() for c in kept) else ""


def fnv1a(text: str) -> int:
    """Hash of a text, 32 bits (Fowler, Noll and Vo's 1a) of its UTF-8 bytes."""
    value = 0x811C9DC5
    for byte in text.encode():
        value = (value ^ byte) * 0x01000193 & 0xFFFFFFFF
    return value


def parts_of(word: str, buckets: int) -> list[int]:
    """Buckets of a word: of "<word>" itself, then of its parts of 3 to 6 letters."""
    whole = f"<{plain(word)}>"
    sizes = range(SHORTEST, LONGEST + 1)
    parts = [whole[i : i + n] for n in sizes for i in range(len(whole) - n + 1) if n < len(whole)]
    return [fnv1a(part) % buckets for part in [whole, *parts]][:PARTS]


class HashedWords(nn.Module):
    """Vectors of words by hashed parts, all learnt: no word is unknown, no file is needed.

    Args:
        buckets: rows that the parts share.
        width: numbers of a vector.
    """

    def __init__(self, buckets: int, width: int) -> None:
        super().__init__()
        self.buckets = buckets
        self.weight = nn.Parameter(torch.randn(buckets, width) / math.sqrt(width))

    def rows(self, words: Sequence[str]) -> Tensor:
        """Rows (1 + V, 64) int64 of words, after the empty row."""
        return _filled([[], *(parts_of(word, self.buckets) for word in words)], PARTS)

    def forward(self, words: Tensor, rows: Tensor) -> Tensor:
        """Vectors (B, T, E) of words (B, T), places in `rows`; zero at place 0."""
        return mean_of_parts(self.weight, words, rows)


class KnownWords(nn.Module):
    """Vectors of the words of a training set, which begin as those of a file.

    Args:
        known: how many words there are.
        width: numbers of a vector.
    """

    def __init__(self, known: int, width: int, letters: int = 0) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.zeros(known, width))
        self.register_buffer("letters", torch.zeros(letters, dtype=torch.uint8))
        self.letters: Tensor

    @classmethod
    def begun(cls, words: Sequence[str], path: Path) -> "KnownWords":
        """The words that a text file of vectors has.

        Raises:
            BadInput: no such file, or it has none of the words.
        """
        known = sorted({plain(word) for word in words} - {""})
        found = read_vectors(path, set(known))
        if not found:
            raise BadInput(f"{path}: has no vector of a word of the transcripts")
        names = [word for word in known if word in found]
        text = "\n".join(names).encode()
        made = cls(len(names), len(found[names[0]]), len(text))
        made.weight.data = torch.from_numpy(np.stack([found[name] for name in names]))
        made.letters.copy_(torch.frombuffer(bytearray(text), dtype=torch.uint8))
        return made

    def rows(self, words: Sequence[str]) -> Tensor:
        """Rows (1 + V, 1) int64 of words, after the empty row; unknown ones are empty, too."""
        names = bytes(self.letters.cpu().tolist()).decode().split("\n")
        place = {name: index for index, name in enumerate(names)}
        return _filled([[], *([place[w]] if (w := plain(x)) in place else [] for x in words)], 1)

    def forward(self, words: Tensor, rows: Tensor) -> Tensor:
        """Vectors (B, T, E) of words (B, T), places in `rows`; zero at place 0."""
        return mean_of_parts(self.weight, words, rows)


def mean_of_parts(weight: Tensor, words: Tensor, rows: Tensor) -> Tensor:
    """Mean (B, T, E) of the weights of the parts of words (B, T); zero without parts."""
    seen, place = words.unique(return_inverse=True)
    parts = rows[seen]  # (U, M)
    there = (parts != NONE).to(weight.dtype)[..., None]
    total = (embedding(parts.clamp_min(0), weight) * there).sum(dim=1)
    return (total / there.sum(dim=1).clamp_min(1))[place]


def _filled(rows: list[list[int]], most: int) -> Tensor:
    table = torch.full((len(rows), most), NONE)
    for row, parts in zip(table, rows, strict=True):
        row[: len(parts)] = torch.tensor(parts, dtype=torch.int64)
    return table


def read_vectors(path: Path, wanted: set[str]) -> dict[str, NDArray[np.float32]]:
    """Vectors of the wanted words in a text file of fastText (`.vec`): a word and numbers a line.

    Raises:
        BadInput: not such a file.
    """
    found: dict[str, NDArray[np.float32]] = {}
    try:
        with Path(path).open(encoding="utf-8") as file:
            first = file.readline().split()
            if len(first) != 2:
                raise ValueError("its first line is not the number of words and of columns")
            width = int(first[1])
            for line in file:
                word, *numbers = line.rstrip().split(" ")
                if word.lower() in wanted and word.lower() not in found:
                    found[word.lower()] = np.array(numbers, np.float32)
                    if len(numbers) != width or not np.isfinite(found[word.lower()]).all():
                        raise ValueError(f"{word} does not have {width} numbers")
    except (OSError, ValueError) as error:
        raise BadInput(
            f"{path}: not a text file of word vectors ({error}); give a .vec file of fastText"
        ) from error
    return found


def words_of_frames(
    words: Sequence[Word], places: Sequence[int], frames: int, fps: float
) -> NDArray[np.int64]:
    """Which word begins in each frame (T,): its place, or 0; of several in a frame the last.

    Args:
        words: with their times.
        places: of each word in the rows of an encoder, above 0.
        frames: T.
        fps: frames a second.
    """
    table = np.zeros(frames, np.int64)
    for word, place in zip(words, places, strict=True):
        frame = math.floor(word.start * fps + 1e-6)
        if 0 <= frame < frames and plain(word.word):
            table[frame] = place
    return table
