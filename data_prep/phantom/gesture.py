"""Strokes: the lexicon of gestures, and which stroke lands on which stressed syllable.

Positions are of the wrist in body units (see `skeleton`) for one side, x outwards. Angles are in
degrees in the same frame: 0 points outwards, -90 up, -180 inwards, -270 down.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from data_prep.phantom.presenters import Style
from data_prep.phantom.script import TRIGGERS
from data_prep.phantom.speech import Speech

Place = tuple[float, float, float]


@dataclass(frozen=True)
class Template:
    """A stroke of one side; two-handed templates mirror it or give the other side its own."""

    prep: Place
    apex: Place
    shape: str
    angle: tuple[float, float]  # at preparation and apex
    turn: float = 0.6
    fore: float = 0.95
    hands: int = 1
    bulge: Place = (0.0, 0.0, 0.0)  # of the path from preparation to apex
    other: tuple[Place, Place] | None = None  # of the second hand, when it differs


def _template(values: dict[str, Any]) -> Template:
    """A template of `gesture.yaml`."""
    other = values.pop("other", None)
    fixed: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}
    return Template(**fixed, other=None if other is None else (tuple(other[0]), tuple(other[1])))


_DATA = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text("utf-8"))

SHAPES: dict[str, tuple[float, ...]] = {k: tuple(v) for k, v in _DATA["shapes"].items()}
"""Curl of the fingers from the thumb on, 0 straight to 1 folded, and the spread between them."""

REST = _template(_DATA["rest"])
"""Hands folded before the waist or on the desk."""

TEMPLATES = {label: _template(values) for label, values in _DATA["templates"].items()}
"""Strokes by label."""

FREE = ("beat", "beats", "offer", "frame", "weigh", "list", "roll", "cut", "palms", "circle",
        "spread", "chest", "rise", "sweep", "pinch", "point_you")  # fmt: skip
"""Strokes that any stressed word may get; the beats are four times as likely as the others."""

RECOIL = 0.2
"""Seconds in which a hand springs back a little after the apex."""

_LEAVE = 0.04
"""Seconds after the apex when a hand is free whose stroke lands on the last syllable."""

_DRIVE, _LIFT = 0.15, 0.13
"""Seconds that a stroke and its preparation take at least."""

_SHORTEST = 0.34
"""Seconds from the end of a stroke to the apex of the next, at least."""


@dataclass(frozen=True)
class Stroke:
    """A stroke in time, seconds: it starts at `onset`, is prepared at `prepared`, lands at `apex`.

    The hand is free again at `end`.
    """

    label: str
    hands: tuple[int, ...]  # 0 right, 1 left; the first leads
    onset: float
    prepared: float
    apex: float
    end: float
    word: int  # index of the word that it goes with
    called: bool  # whether the word calls for this stroke


def _hands(template: Template, style: Style, rng: np.random.Generator) -> tuple[int, ...]:
    lead = 0 if rng.random() < style.right_hand else 1
    return (lead, 1 - lead) if template.hands == 2 else (lead,)


def _choice(style: Style, before: str, rng: np.random.Generator) -> str:
    weight = np.array([
        (4.0 if label in ("beat", "beats") else 1.0) * (3.0 if label in style.favourites else 1.0)
        * (0.25 if label == before else 1.0)
        for label in FREE
    ])  # fmt: skip
    return str(rng.choice(FREE, p=weight / weight.sum()))


def _stroke_time(template: Template, style: Style) -> float:
    """Seconds from preparation to apex: 0.18 to 0.42, longer for longer paths."""
    path = float(np.linalg.norm(np.subtract(template.prep, template.apex)))
    path += 0.8 * float(np.abs(template.bulge).sum())
    return float(np.clip((0.17 + 0.0016 * path) / style.quickness, 0.18, 0.42))


def _near(pulse: NDArray, wanted: float, low: float, high: float) -> float | None:
    """The syllable of the pulse nearest to `wanted` within [low, high], None when there is none."""
    inside = pulse[(pulse >= low) & (pulse <= high)]
    return float(inside[np.argmin(np.abs(inside - wanted))]) if len(inside) else None


def _placed(
    template: Template, beat: float, free: float, pulse: NDArray, style: Style,
    rng: np.random.Generator,
) -> tuple[float, float, float]:  # fmt: skip
    """Onset, end of preparation and end of a stroke whose apex is at `beat`.

    All three fall on syllables where there is one in reach, since movement is phrased with speech.

    Args:
        template: gives the length of the path.
        beat: onset of the stressed vowel.
        free: when the hands are free.
        pulse: syllables that movement keeps time with.
        style: gives the speed.
        rng: source of randomness.
    """
    drive = _stroke_time(template, style)
    lift = float(rng.uniform(0.30, 0.44)) / style.quickness
    prepared = _near(pulse, beat - drive, max(beat - 0.55, free + _LIFT), beat - _DRIVE)
    if prepared is None:
        prepared = max(beat - min(drive, 0.21), min(free + _LIFT, beat - _DRIVE))
    onset = _near(pulse, prepared - lift, max(prepared - 0.7, free), prepared - _LIFT)
    if onset is None:
        onset = max(prepared - lift, free)
    end = _near(pulse, beat + RECOIL, beat + 0.14, beat + 0.5)
    return onset, prepared, beat + _LEAVE if end is None else end


def schedule(speech: Speech, style: Style, rng: np.random.Generator) -> list[Stroke]:
    """Strokes in order of time, each with its apex on a stressed syllable.

    Words in `TRIGGERS` always get their stroke, on their first stressed syllable. Other stressed
    words get one with the probability `style.tempo` where there is time for it.

    Args:
        speech: words with their beats.
        style: of the presenter.
        rng: source of randomness.
    """
    targets = [(word.beats[0], i, TRIGGERS.get(word.word))
               for i, word in enumerate(speech.words) if word.beats]  # fmt: skip
    strokes: list[Stroke] = []
    pulse = speech.pulse
    for position, (beat, index, label) in enumerate(targets):
        free = strokes[-1].end if strokes else 0.1
        start, _ = speech.phrases[speech.words[index].phrase]
        ahead = targets[position + 1 :]
        called_next = next((b for b, _, name in ahead if name), np.inf)
        if label is None:
            busy = called_next - beat < 0.75 or beat - max(free, start - 0.3) < 0.5
            if busy or rng.random() > style.tempo:
                continue
            before = strokes[-1].label if strokes else ""
            label, called = _choice(style, before, rng), False
        else:
            called = True
            while strokes and not strokes[-1].called and beat - strokes[-1].end < _SHORTEST:
                strokes.pop()
            free = strokes[-1].end if strokes else 0.1
        template = TEMPLATES[label]
        onset, prepared, end = _placed(template, beat, free, pulse, style, rng)
        hands = _hands(template, style, rng)
        strokes.append(Stroke(label, hands, onset, prepared, beat, end, index, called))
    return strokes
