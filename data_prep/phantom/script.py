"""What the phantom says: sentences from a small grammar, cut into phrases with pauses."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

LEXICON: dict[str, tuple[str, ...]] = {
    word: tuple(phones)
    for word, *phones in map(
        str.split, (Path(__file__).parent / "lexicon.txt").read_text("utf-8").splitlines()
    )
}
"""ARPAbet phones of each word that can be said; vowels end in 1 (stressed) or 0."""

TRIGGERS = {
    "big": "spread", "huge": "spread", "wide": "spread",
    "small": "pinch", "tiny": "pinch", "little": "pinch",
    "you": "point_you", "me": "point_me",
    "up": "up", "down": "down",
    "many": "sweep", "everything": "sweep", "all": "sweep",
    "first": "one", "second": "two", "third": "three",
    "never": "wave_off", "nothing": "wave_off", "no": "cut", "not": "cut",
    "around": "circle", "turn": "circle", "stop": "palms", "wait": "palms",
    "heart": "chest", "feel": "chest", "balance": "weigh", "between": "weigh",
    "rise": "rise", "rising": "rise", "falling": "fall",
    "together": "gather", "give": "offer", "offer": "offer",
    "think": "think", "remember": "think", "here": "here",
}  # fmt: skip
"""Words that always call for a stroke, and which."""

_SLOTS = {
    "thing": ("idea", "story", "problem", "question", "plan", "picture", "machine", "letter",
              "language", "number", "market", "system", "answer", "river", "garden", "paper"),
    "things": ("people", "music", "water", "energy", "science", "data", "history", "money",
               "nature", "weather", "work", "light"),
    "person": ("doctor", "teacher", "student", "family", "group", "human"),
    "place": ("house", "city", "school", "field", "mountain", "world", "table", "window", "road"),
    "way": ("simple", "clear", "easy", "hard", "important", "different", "careful", "strong",
            "deep", "young", "new", "great", "good"),
    "when": ("today", "now", "tomorrow", "yesterday", "again", "slowly", "always", "often"),
    "do": ("make", "build", "find", "change", "learn", "open", "bring", "show", "travel", "grow"),
    "size": ("big", "huge", "small", "tiny", "little", "wide"),
    "deny": ("never", "not"),
}  # fmt: skip

_SENTENCES = (
    "the [thing] was very [size], and the [person] was [way]",
    "first, we [do] the [thing]. second, we [do] the [place]. third, we look at the [things]",
    "we mean you, the [person] in the [place]",
    "tell me about the [thing], and the [person] with the [way] [thing]",
    "prices are rising [when], and the cost of [things] is falling",
    "we look up at the [place], and walking down to the river",
    "there are many [person] in the [place], and the [things] is [way]",
    "it was [deny] about the [things], but the [thing] was [way]",
    "turn the [thing] around, and show the other side",
    "stop, because the [person] is moving into the [place]",
    "every [person] should feel the [things] of the [place]",
    "the balance of [things] and money is [way] [when]",
    "we work together [when], to [do] the [thing]",
    "give the [thing] to the [person], and [do] the [way] [place]",
    "we think the [thing] of the [person] is [way]",
    "here is the [thing], a [size] example of [things]",
    "the [way] [thing] is a [thing] of [things]",
    "when the [person] began to [do] the [thing], the [place] was open",
    "the [person] can [do] the [place], the [thing], and the [things]",
    "if we [do] the [thing] [when], the future is [way]",
    "wait a minute, the [person] will [do] the [thing]",
    "nothing in the [place] was [size], and the morning was long",
    "everything in the [place] will change, and the [thing] will grow",
    "remember the [thing], the reason is [way]",
    "the [person] was running across the [place], into the light",
    "some of the [things] will rise, and the [thing] is clear",
    "no, the [thing] is [way], that is the point",
    "our heart is in the [place], with the [person] and the [things]",
    "between the [place] and the [place], there is a [size] road",
    "we speak about the [way] [thing], the [way] [person], and the [way] [place]",
)


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
