"""Phones as acoustic targets, and the segments of a phrase with durations, pitch and stress.

Formant frequencies are of an adult male voice (Peterson and Barney 1952; Klatt 1980, tables II
and III, rounded); a voice scales them.
"""

from dataclasses import dataclass
from pathlib import Path

import yaml

DATA = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text("utf-8"))

VOWELS: dict[str, list[tuple[float, float, float]]] = {
    name: [tuple(target) for target in vowel["targets"]] for name, vowel in DATA["vowels"].items()
}
"""Targets (F1, F2, F3) in hertz; diphthongs glide from the first to the second."""

_PLACES = {name: tuple(target) for name, target in DATA["places"].items()}
_FRICATIVES, _STOPS, _SONORANTS = (DATA[name] for name in ("fricatives", "stops", "sonorants"))


@dataclass(frozen=True)
class Segment:
    """A stretch of steady articulation.

    Levels are relative amplitudes; `noise` is centre and bandwidth of frication in hertz.
    """

    phone: str
    duration: float
    start: tuple[float, float, float]
    end: tuple[float, float, float]
    voicing: float
    breath: float = 0.0
    friction: float = 0.0
    noise: tuple[float, float] = (4000.0, 2000.0)
    broad: float = 1.0  # scales bandwidths: nasals and closures are damped
    stress: int = 0
    nucleus: bool = False  # first segment of a vowel
    open: float = 0.1  # lips and jaw, 0 closed to 1
    spread: float = 0.6  # lips, 0 rounded to 1 spread

    @property
    def vowel(self) -> bool:
        """Whether this is (part of) a vowel."""
        return self.phone in VOWELS


_CODA = 0.4
"""Level of noise that ends a syllable over that of noise that begins it."""


def _vowel(name: str, stress: int, longer: float) -> list[Segment]:
    targets = VOWELS[name]
    if not stress and len(targets) == 1 and name not in ("ER", "IY"):
        mid = (520.0, 1450.0, 2500.0)
        targets = [tuple(0.7 * a + 0.3 * b for a, b in zip(targets[0], mid, strict=True))]  # type: ignore[list-item]
    length = DATA["vowels"][name]["length"] * longer * (1.12 if stress else 0.8)
    level = 1.0 if stress else 0.55
    opening = [min(1.0, (t[0] - 200) / 480) for t in targets]
    spread = [min(1.0, max(0.0, (t[1] - 800) / 1400)) for t in targets]
    if len(targets) == 1:
        shape = dict(stress=stress, open=opening[0], spread=spread[0])
        return [Segment(name, length, targets[0], targets[0], level, nucleus=True, **shape)]  # type: ignore[arg-type]
    first, second = targets
    return [
        Segment(name, 0.45 * length, first, first, level, stress=stress, nucleus=True,
                open=opening[0], spread=spread[0]),
        Segment(name, 0.55 * length, first, second, 0.9 * level, stress=stress,
                open=opening[1], spread=spread[1]),
    ]  # fmt: skip


def _stop(name: str, after: str | None, stressed: bool, final: bool) -> list[Segment]:
    """Closure, burst and aspiration.

    A stop that ends a word is not released, or before a vowel is a tap (T, D) or weak.
    """
    where, centre, band, level, voiced, closure = _STOPS[name]
    place, shut = _PLACES[where], 0.0 if where == "labial" else 0.15
    out = [Segment(name, closure, place, place, 0.16 if voiced else 0.0, broad=2.5, open=shut)]
    noise = (float(centre), float(band))
    if final and after not in VOWELS:
        return out
    if final and name in "TD":
        return [Segment(name, 0.03, place, place, 0.35, broad=1.8, open=0.2)]
    level *= _CODA if final else 1.0
    out.append(Segment(name, 0.012, place, place, 0.1 if voiced else 0.0, friction=level,
                       noise=noise, open=shut + 0.05))  # fmt: skip
    if not (voiced or final) and (after in VOWELS or after in _SONORANTS):
        length = 0.045 if stressed else 0.025
        out.append(Segment(name, length, place, place, 0.0, breath=0.5, friction=0.1 * level,
                           noise=noise, open=0.2))  # fmt: skip
    return out


def segments(phones: tuple[str, ...], following: str | None, longer: float = 1.0) -> list[Segment]:
    """Segments of a word.

    Args:
        phones: ARPAbet with stress digits on vowels.
        following: first phone of the next word in the phrase, None at the end.
        longer: scales vowels and sonorants, above 1 at the end of a phrase.
    """
    out: list[Segment] = []
    bare = [p.rstrip("01") for p in phones]
    last = max(index for index, name in enumerate(bare) if name in VOWELS)
    for index, name in enumerate(bare):
        final = index > last
        after = bare[index + 1] if index + 1 < len(bare) else following
        stressed = index + 1 < len(phones) and phones[index + 1].endswith("1")
        if name in VOWELS:
            out += _vowel(name, int(phones[index][-1]), longer)
        elif name in _FRICATIVES:
            where, centre, band, level, voiced, length = _FRICATIVES[name]
            place = _PLACES[where]
            level *= _CODA if final else 1.0
            out.append(Segment(name, length, place, place, 0.32 if voiced else 0.0, friction=level,
                               noise=(float(centre), float(band)), open=0.12))  # fmt: skip
        elif name in _STOPS:
            out += _stop(name, after, stressed, final)
        elif name in ("CH", "JH"):
            fused = "T" if name == "CH" else "D"
            out += _stop(fused, None, stressed, final)
            level, voicing = (0.5, 0.0) if name == "CH" else (0.3, 0.2)
            level *= _CODA if final else 1.0
            noise = (3200.0, 1700.0)
            out.append(
                Segment(
                    name, 0.07, _PLACES["palatal"], _PLACES["palatal"], voicing,
                    friction=level, noise=noise, open=0.15, spread=0.2,
                )
            )  # fmt: skip
        elif name == "HH":
            vowel = VOWELS[after][0] if after in VOWELS else _PLACES["glottal"]
            out.append(Segment(name, 0.06, vowel, vowel, 0.0, breath=0.65, open=0.3))
        else:
            target, level, broad, length, opening, spread = _SONORANTS[name]
            target = tuple(target)
            scale = length * (0.5 + 0.5 * longer)
            out.append(Segment(name, scale, target, target, level, broad=broad, open=opening,
                               spread=spread))  # fmt: skip
    return out
