"""The presenters: who they are (looks, voice, style) and what changes from video to video."""

from dataclasses import dataclass, replace

import numpy as np

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

_LOOKS = (
    Look((0.87, 0.67, 0.55), (0.23, 0.15, 0.10), "short", (0.30, 0.38, 0.42), (0.70, 0.42, 0.38),
         1.0, 1.05, 1.0, 1.0, 0.35, False, 80, 1.0, ("blazer", "shirt", "sweater")),
    Look((0.93, 0.76, 0.66), (0.48, 0.28, 0.14), "long", (0.35, 0.30, 0.20), (0.78, 0.38, 0.38),
         0.95, 0.90, 0.9, 0.8, 0.0, False, 70, 0.88, ("blouse", "sweater", "blazer", "tee")),
    Look((0.47, 0.31, 0.22), (0.07, 0.06, 0.06), "crop", (0.16, 0.10, 0.07), (0.45, 0.25, 0.22),
         1.04, 1.08, 1.15, 1.1, 0.55, True, 84, 1.08, ("shirt", "tee", "blazer", "sweater")),
    Look((0.76, 0.56, 0.42), (0.08, 0.07, 0.08), "bob", (0.17, 0.11, 0.08), (0.68, 0.34, 0.34),
         0.98, 0.92, 0.95, 0.9, 0.0, False, 68, 0.86, ("sweater", "blazer", "blouse", "shirt")),
    Look((0.90, 0.71, 0.60), (0.62, 0.60, 0.58), "short", (0.36, 0.45, 0.52), (0.68, 0.44, 0.40),
         1.05, 1.02, 1.1, 0.9, 0.0, True, 82, 1.14, ("blazer", "shirt", "sweater")),
    Look((0.60, 0.41, 0.30), (0.12, 0.08, 0.07), "curly", (0.20, 0.13, 0.08), (0.58, 0.29, 0.28),
         0.97, 0.94, 1.05, 0.9, 0.0, False, 71, 0.92, ("tee", "blouse", "sweater", "blazer")),
)  # fmt: skip

_STYLES = (
    Style(1.00, 0.85, 0.80, 1.00, 0, 1.0, 1.0, 1.0, ("beat", "list", "cut", "point_you")),
    Style(1.25, 0.65, 0.92, 1.15, -14, 1.3, 1.3, 1.2, ("beats", "spread", "palms", "circle")),
    Style(0.72, 0.90, 0.62, 0.85, 8, 0.7, 0.7, 0.8, ("beat", "pinch", "weigh", "frame")),
    Style(0.95, 0.12, 0.80, 1.10, -4, 1.1, 0.9, 1.1, ("beat", "chest", "offer", "sweep")),
    Style(1.10, 0.75, 0.70, 0.80, 2, 0.9, 1.2, 0.9, ("beats", "rise", "frame", "weigh")),
    Style(1.15, 0.30, 0.88, 1.20, -10, 1.2, 1.1, 1.1, ("circle", "roll", "spread", "offer")),
)

_VOICES = (
    Voice(112, 5.0, 1.00, 1.00, 0.03, 0.65, 1.0, "m3", 45),
    Voice(205, 6.0, 1.17, 1.06, 0.05, 0.60, 1.0, "f2", 55),
    Voice(86, 3.5, 0.92, 0.92, 0.03, 0.70, 1.0, "m7", 25),
    Voice(178, 4.5, 1.12, 0.98, 0.12, 0.40, 1.0, "f4", 40),
    Voice(132, 5.0, 1.00, 0.88, 0.10, 0.45, 3.0, "m5", 50),
    Voice(255, 6.0, 1.24, 1.06, 0.05, 0.65, 0.7, "f5", 85),
)
"""A man, a woman, a deep man, a breathy woman, an old man and a young, small voice."""

_NAMES = ("adam", "bella", "carl", "dora", "emil", "fay")


def presenter(index: int, seed: int = 0) -> Presenter:
    """The presenter of that number.

    The first six are drawn by hand; later ones mix looks, styles and voices by the seed.
    """
    if index < len(_NAMES):
        return Presenter(_NAMES[index], _LOOKS[index], _STYLES[index], _VOICES[index])
    rng = np.random.default_rng([seed, index, 101])
    pick = int(rng.integers(len(_LOOKS)))
    tone = float(rng.uniform(0.75, 1.1))
    red, green, blue = (float(min(0.95, c * tone)) for c in _LOOKS[pick].skin)
    look = replace(
        _LOOKS[pick],
        skin=(red, green, blue),
        face_width=float(rng.uniform(0.93, 1.07)),
        jaw=float(rng.uniform(0.9, 1.1)),
        glasses=bool(rng.random() < 0.3),
    )
    style = _STYLES[int(rng.integers(len(_STYLES)))]
    style = replace(style, amplitude=float(rng.uniform(0.75, 1.25)))
    voice = replace(_VOICES[pick], rate=float(rng.uniform(0.9, 1.1)))
    return Presenter(f"{_NAMES[pick]}{index}", look, style, voice)


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
