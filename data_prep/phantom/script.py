"""What the phantom says: sentences from a small grammar, cut into phrases with pauses."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

LEXICON: dict[str, tuple[str, ...]] = {
    word: tuple(phones)
    for word, *phones in map(
        str.split, (Path(__file__).parent / "lexicon.txt").read_text("utf-8").splitlines()
    )
}
"""ARPAbet phones of each word that can be said; vowels end in 1 (stressed) or 0."""

_DATA = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text("utf-8"))

TRIGGERS: dict[str, str] = _DATA["triggers"]
"""Words that always call for a stroke, and which."""

_SLOTS: dict[str, list[str]] = _DATA["slots"]
_SENTENCES: list[str] = _DATA["sentences"]


@dataclass(frozen=True)
class Phrase:
    """Words said in one breath, and the pause after them in seconds."""

    words: tuple[str, ...]
    pause: float
    final: bool  # the last of its sentence
    tempo: float = 1.0  # scales the speed of the voice


def _fill(sentence: str, rng: np.random.Generator) -> list[str]:
    words = []
    for token in sentence.replace(",", " ,").replace(".", " .").split():
        if token.startswith("["):
            token = str(rng.choice(_SLOTS[token.strip("[]")]))
        words.append(token)
    return words


def script(duration: float, rate: float, rng: np.random.Generator) -> list[Phrase]:
    """Phrases that fill about `duration` seconds with pauses between them.

    Pauses last 0.45 to 0.75 s inside a sentence and 0.9 to 1.6 s after one; every second sentence
    is followed by a silence of 2 to 3 s. The tempo changes from phrase to phrase.

    Args:
        duration: seconds to fill.
        rate: speed of the voice, 1 for about 2.75 words a second.
        rng: source of randomness.
    """
    phrases: list[Phrase] = []
    spent, since = 0.0, int(rng.integers(0, 2))
    order: list[int] = []
    while spent < duration:
        if not order:
            order = [int(i) for i in rng.permutation(len(_SENTENCES))]
        words: list[str] = []
        tokens = [*_fill(_SENTENCES[order.pop()], rng), "."]
        for index, token in enumerate(tokens):
            if token not in ",.":
                words.append(token)
                continue
            last = index == len(tokens) - 1
            pause = float(rng.uniform(0.45, 0.75))
            if last:
                since += 1
                pause = float(rng.uniform(2.0, 3.0) if since % 2 else rng.uniform(0.9, 1.6))
            tempo = float(rng.uniform(0.88, 1.14))
            phrases.append(Phrase(tuple(words), pause, token == ".", tempo))
            spent += pause + len(words) / (2.75 * rate * tempo)
            words = []
    return phrases
