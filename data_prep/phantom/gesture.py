"""Strokes: the lexicon of gestures, and which stroke lands on which stressed syllable.

Positions are of the wrist in body units (see `skeleton`) for one side, x outwards. Angles are in
degrees in the same frame: 0 points outwards, -90 up, -180 inwards, -270 down.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_prep.phantom.presenters import Style
from data_prep.phantom.script import TRIGGERS
from data_prep.phantom.speech import Speech

Place = tuple[float, float, float]

SHAPES: dict[str, tuple[float, ...]] = {
    "relaxed": (0.35, 0.28, 0.34, 0.40, 0.46, 0.35),
    "open": (0.05, 0.02, 0.00, 0.02, 0.05, 1.15),
    "flat": (0.25, 0.03, 0.03, 0.03, 0.05, 0.15),
    "fist": (0.75, 0.95, 0.95, 0.95, 0.95, 0.10),
    "point": (0.70, 0.02, 0.92, 0.95, 0.95, 0.20),
    "pinch": (0.55, 0.52, 0.30, 0.26, 0.24, 0.55),
    "two": (0.75, 0.02, 0.02, 0.95, 0.95, 0.80),
    "three": (0.10, 0.02, 0.02, 0.95, 0.95, 0.95),
    "cup": (0.30, 0.36, 0.36, 0.36, 0.36, 0.60),
}
"""Curl of the fingers from the thumb on, 0 straight to 1 folded, and the spread between them."""


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


REST = Template((37, 152, 62), (37, 152, 62), "relaxed", (-206, -206), -0.7, 0.9)
"""Hands folded before the waist or on the desk."""

TEMPLATES: dict[str, Template] = {
    "beat": Template((66, 78, 80), (70, 124, 95), "relaxed", (-118, -100), 0.5, 0.8),
    "beats": Template((60, 76, 85), (66, 122, 95), "cup", (-115, -95), 0.4, 0.85, 2),
    "spread": Template((30, 98, 95), (132, 82, 45), "open", (-95, -48), 1.0, 1.0, 2),
    "pinch": Template((62, 78, 95), (46, 98, 125), "pinch", (-105, -125), 0.8, 1.0),
    "up": Template((70, 112, 80), (82, -2, 55), "point", (-80, -90), 0.8, 1.0),
    "down": Template((76, 62, 80), (78, 138, 85), "point", (-120, -262), 0.7, 1.0),
    "point_you": Template((66, 96, 50), (48, 66, 150), "point", (-100, -112), 0.5, 0.62),
    "point_me": Template((84, 104, 90), (26, 74, 56), "point", (-110, -172), 0.7, 1.0),
    "one": Template((72, 96, 80), (64, 66, 108), "point", (-95, -92), 0.9, 1.0),
    "two": Template((74, 96, 80), (68, 62, 108), "two", (-95, -90), 0.9, 1.0),
    "three": Template((76, 96, 80), (72, 58, 108), "three", (-95, -88), 0.9, 1.0),
    "list": Template((58, 74, 90), (78, 100, 100), "two", (-110, -80), 0.8, 1.0),
    "wave_off": Template((34, 66, 90), (122, 106, 60), "flat", (-150, -20), 0.4, 0.95),
    "circle": Template((62, 62, 85), (58, 112, 95), "point", (-100, -115), 0.7, 0.95,
                       bulge=(62, -6, 0)),
    "palms": Template((50, 112, 60), (76, 54, 125), "open", (-100, -82), 1.0, 1.0, 2),
    "chest": Template((78, 104, 85), (20, 64, 52), "flat", (-130, -168), 0.9, 1.0),
    "cut": Template((14, 80, 95), (104, 104, 75), "flat", (-175, -40), 0.25, 1.0),
    "weigh": Template((76, 96, 90), (92, 128, 90), "cup", (-70, -30), -0.7, 0.9, 2,
                      other=((76, 96, 90), (88, 62, 90))),
    "sweep": Template((-8, 82, 98), (130, 90, 50), "open", (-165, -30), 0.9, 1.0,
                      bulge=(0, 14, 20)),
    "rise": Template((64, 134, 85), (82, 40, 75), "flat", (-60, -50), -0.8, 0.9, 2),
    "fall": Template((78, 40, 80), (70, 134, 90), "flat", (-120, -195), 0.6, 0.9, 2),
    "gather": Template((112, 82, 60), (24, 104, 98), "cup", (-70, -160), 0.5, 0.95, 2),
    "offer": Template((54, 104, 70), (96, 114, 125), "cup", (-100, -35), -0.8, 0.85),
    "frame": Template((92, 66, 85), (50, 92, 115), "flat", (-80, -98), 0.2, 0.95, 2),
    "roll": Template((52, 74, 95), (50, 114, 108), "cup", (-140, -130), 0.4, 0.9, 2,
                     bulge=(44, 0, 25)),
    "think": Template((84, 84, 75), (88, -26, 40), "point", (-100, -116), 0.7, 1.0),
    "here": Template((58, 72, 95), (54, 142, 105), "point", (-120, -250), 0.7, 0.95),
}  # fmt: skip
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


def _travel(a: Place, b: Place) -> float:
    return float(np.linalg.norm(np.subtract(a, b)))


def _stroke_time(template: Template, style: Style) -> float:
    """Seconds from preparation to apex: 0.18 to 0.42, longer for longer paths."""
    path = _travel(template.prep, template.apex) + 0.8 * float(np.abs(template.bulge).sum())
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
