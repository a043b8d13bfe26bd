"""The presenters: who they are (looks, voice, style) and what changes from video to video."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from data_prep.phantom.paint import CLOTHS

Colour = tuple[float, float, float]


@dataclass(frozen=True)
class Look:
    """How a presenter looks; colours are RGB in [0, 1], sizes in hundredths of a head."""

    skin: Colour
    hair: Colour
    hair_cut: str  # short, crop, bob, long, bun, bald, curly
    eye: Colour
    lip: Colour
    face_width: float  # 1 is average
    jaw: float  # 1 is average
    nose: float
    brow: float
    beard: float  # coverage in [0, 1]
    glasses: bool
    shoulders: float  # half distance of the shoulder joints
    girth: float  # 1 is average
    garments: tuple[str, ...]  # blazer, shirt, sweater, tee, blouse


@dataclass(frozen=True)
class Style:
    """How a presenter moves."""

    amplitude: float  # scales every stroke
    right_hand: float  # probability that a one-handed stroke uses the right hand
    tempo: float  # probability that a stressed word gets a stroke of its own
    quickness: float  # scales the speed of strokes
    height: float  # raises (negative) or lowers the gesture space, hundredths of a head
    nod: float  # size of head nods
    sway: float  # size of the body's sway
    bounce: float  # size of the beats superimposed on a held hand
    favourites: tuple[str, ...]  # strokes chosen three times as often


@dataclass(frozen=True)
class Voice:
    """How a presenter sounds."""

    pitch: float  # mean fundamental frequency, hertz
    span: float  # pitch range of an accent, semitones
    formants: float  # scales every formant frequency
    rate: float  # scales the speed of speech
    breath: float  # aspiration relative to voicing
    effort: float  # spectral tilt: 0 soft, 1 bright
    rough: float = 1.0  # scales jitter and shimmer
    espeak: str = "m3"  # variant of the same kind in eSpeak NG
    espeak_pitch: int = 50  # 0 to 99


@dataclass(frozen=True)
class Presenter:
    """A phantom speaker."""

    name: str
    look: Look
    style: Style
    voice: Voice


@dataclass(frozen=True)
class Setting:
    """What belongs to one video: clothes, place and light."""

    garment: str
    pattern: str
    first: Colour
    second: Colour
    under: Colour
    sleeve: str  # long, rolled, short
    place: str
    seated: bool
    light: tuple[float, float, float]
    warmth: float  # colour temperature, -1 cold to 1 warm
    exposure: float
    blur: float  # of the lens, pixels
    grain: float  # of the sensor, 8-bit steps
    position: float  # of the neck, pixels right of the centre
    zoom: float  # pixels a unit


PLACES = ("wall", "shelf", "curtain", "studio", "bokeh", "brick", "window", "mural")
"""Kinds of background."""


def _by_hand() -> list[Presenter]:
    """The presenters of `presenters.yaml`."""

    def part(kind: type, values: dict[str, Any]) -> Any:
        return kind(**{k: tuple(v) if isinstance(v, list) else v for k, v in values.items()})

    rows = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text("utf-8"))
    kinds = {"look": Look, "style": Style, "voice": Voice}
    return [
        Presenter(r["name"], **{k: part(kind, r[k]) for k, kind in kinds.items()}) for r in rows
    ]


BY_HAND = _by_hand()


def presenter(index: int, seed: int = 0) -> Presenter:
    """The presenter of that number.

    The first six are drawn by hand; later ones mix looks, styles and voices by the seed.
    """
    if index < len(BY_HAND):
        return BY_HAND[index]
    rng = np.random.default_rng([seed, index, 101])
    pick = BY_HAND[int(rng.integers(len(BY_HAND)))]
    tone = float(rng.uniform(0.75, 1.1))
    red, green, blue = (float(min(0.95, c * tone)) for c in pick.look.skin)
    look = replace(
        pick.look,
        skin=(red, green, blue),
        face_width=float(rng.uniform(0.93, 1.07)),
        jaw=float(rng.uniform(0.9, 1.1)),
        glasses=bool(rng.random() < 0.3),
    )
    style = BY_HAND[int(rng.integers(len(BY_HAND)))].style
    style = replace(style, amplitude=float(rng.uniform(0.75, 1.25)))
    voice = replace(pick.voice, rate=float(rng.uniform(0.9, 1.1)))
    return Presenter(f"{pick.name}{index}", look, style, voice)


def _hue(rng: np.random.Generator, saturation: float, value: float) -> Colour:
    hue = rng.uniform(0, 6)
    wheel = [abs(hue - 3) - 1, 2 - abs(hue - 2), 2 - abs(hue - 4)]
    pure = np.clip(wheel, 0, 1)
    red, green, blue = value * (1 - saturation + saturation * pure)
    return float(red), float(green), float(blue)


def setting(who: Presenter, rng: np.random.Generator) -> Setting:
    """Clothes, place, light and framing of one video of a presenter."""
    garment = str(rng.choice(who.look.garments))
    value = float(rng.uniform(0.2, 0.85))
    first = _hue(rng, float(rng.uniform(0.1, 0.65)), value)
    other = value + (0.35 if value < 0.5 else -0.35)
    second = _hue(rng, float(rng.uniform(0.0, 0.5)), other)
    white = float(rng.uniform(0.72, 0.92))
    angle, elevation = rng.uniform(-1.0, 1.0), rng.uniform(0.35, 0.75)
    direction = np.array([np.sin(angle), -elevation, 1.1])
    x, y, z = direction / np.linalg.norm(direction)
    sleeves = {"tee": ("short",), "shirt": ("long", "rolled"), "blouse": ("long", "short")}
    return Setting(
        garment=garment,
        pattern=str(rng.choice(CLOTHS)),
        first=first,
        second=second,
        under=(white, white * 0.985, white * 0.96),
        sleeve=str(rng.choice(sleeves.get(garment, ("long",)))),
        place=str(rng.choice(PLACES)),
        seated=bool(rng.random() < 0.6),
        light=(float(x), float(y), float(z)),
        warmth=float(rng.uniform(-1, 1)),
        exposure=float(rng.uniform(0.88, 1.1)),
        blur=float(rng.uniform(0.35, 0.7)),
        grain=float(rng.uniform(1.0, 3.0)),
        position=float(rng.uniform(-24, 24)),
        zoom=float(rng.uniform(0.98, 1.08)),
    )
