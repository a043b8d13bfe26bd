"""Phones as acoustic targets, and the segments of a phrase with durations, pitch and stress.

Formant frequencies are of an adult male voice (Peterson and Barney 1952; Klatt 1980, tables II
and III, rounded); a voice scales them.
"""

from dataclasses import dataclass

VOWELS: dict[str, tuple[tuple[float, float, float], ...]] = {
    "AA": ((720, 1120, 2550),), "AE": ((680, 1700, 2430),), "AH": ((620, 1210, 2500),),
    "AO": ((590, 880, 2500),), "EH": ((540, 1800, 2500),), "ER": ((480, 1300, 1640),),
    "IH": ((400, 1950, 2580),), "IY": ((290, 2250, 2950),), "UH": ((440, 1030, 2350),),
    "UW": ((310, 950, 2250),), "AW": ((720, 1250, 2500), (460, 900, 2400)),
    "AY": ((720, 1200, 2500), (380, 2100, 2600)), "EY": ((500, 1850, 2500), (340, 2200, 2650)),
    "OW": ((540, 1000, 2400), (380, 820, 2350)), "OY": ((560, 880, 2450), (380, 1950, 2550)),
}  # fmt: skip
"""Targets (F1, F2, F3) in hertz; diphthongs glide from the first to the second."""

_LENGTH = {
    "AA": 0.13, "AE": 0.13, "AH": 0.09, "AO": 0.13, "EH": 0.10, "ER": 0.12, "IH": 0.085,
    "IY": 0.12, "UH": 0.095, "UW": 0.12, "AW": 0.16, "AY": 0.16, "EY": 0.14, "OW": 0.14, "OY": 0.18,
}  # fmt: skip

LABIAL, DENTAL, ALVEOLAR = (340, 900, 2250), (340, 1300, 2600), (340, 1720, 2680)
PALATAL, VELAR, GLOTTAL = (310, 2000, 2700), (300, 1900, 2250), (500, 1500, 2500)


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


_FRICATIVES = {  # place, centre, bandwidth, level, voiced, duration
    "S": (ALVEOLAR, 6500, 2600, 0.50, False, 0.095), "Z": (ALVEOLAR, 6300, 2600, 0.26, True, 0.075),
    "SH": (PALATAL, 3100, 1700, 0.50, False, 0.095), "ZH": (PALATAL, 3000, 1700, 0.26, True, 0.07),
    "F": (LABIAL, 5200, 6500, 0.13, False, 0.085), "V": (LABIAL, 4500, 6000, 0.06, True, 0.06),
    "TH": (DENTAL, 6200, 5000, 0.11, False, 0.08), "DH": (DENTAL, 5500, 5000, 0.02, True, 0.045),
}  # fmt: skip
_STOPS = {  # place, burst centre, burst bandwidth, level, voiced, closure
    "P": (LABIAL, 1200, 2200, 0.35, False, 0.065), "B": (LABIAL, 900, 1500, 0.22, True, 0.055),
    "T": (ALVEOLAR, 4600, 2600, 0.60, False, 0.055), "D": (ALVEOLAR, 4000, 2600, 0.32, True, 0.045),
    "K": (VELAR, 2100, 900, 0.60, False, 0.060), "G": (VELAR, 2000, 900, 0.34, True, 0.050),
}  # fmt: skip
_SONORANTS = {  # targets, level, bandwidth scale, duration, opening, spread
    "M": ((260, 1050, 2200), 0.42, 2.2, 0.07, 0.0, 0.6),
    "N": ((260, 1600, 2600), 0.42, 2.2, 0.065, 0.15, 0.6),
    "NG": ((270, 2000, 2600), 0.40, 2.2, 0.07, 0.2, 0.6),
    "L": ((350, 1000, 2700), 0.62, 1.2, 0.065, 0.3, 0.6),
    "R": ((330, 1150, 1500), 0.62, 1.1, 0.07, 0.25, 0.2),
    "W": ((300, 650, 2250), 0.58, 1.2, 0.065, 0.12, 0.0),
    "Y": ((270, 2250, 2950), 0.58, 1.2, 0.06, 0.2, 0.9),
}  # fmt: skip

_CODA = 0.4
"""Level of noise that ends a syllable over that of noise that begins it."""


def _vowel(name: str, stress: int, longer: float) -> list[Segment]:
    targets = VOWELS[name]
    if not stress and len(targets) == 1 and name not in ("ER", "IY"):
        mid = (520.0, 1450.0, 2500.0)
        targets = (tuple(0.7 * a + 0.3 * b for a, b in zip(targets[0], mid, strict=True)),)  # type: ignore[assignment]
    length = _LENGTH[name] * longer * (1.12 if stress else 0.8)
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
    place, centre, band, level, voiced, closure = _STOPS[name]
    shut = 0.0 if place is LABIAL else 0.15
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
            place, centre, band, level, voiced, length = _FRICATIVES[name]
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
                    name, 0.07, PALATAL, PALATAL, voicing,
                    friction=level, noise=noise, open=0.15, spread=0.2,
                )
            )  # fmt: skip
        elif name == "HH":
            vowel = VOWELS[after][0] if after in VOWELS else GLOTTAL
            out.append(Segment(name, 0.06, vowel, vowel, 0.0, breath=0.65, open=0.3))
        else:
            target, level, broad, length, opening, spread = _SONORANTS[name]
            scale = length * (0.5 + 0.5 * longer)
            out.append(Segment(name, scale, target, target, level, broad=broad, open=opening,
                               spread=spread))  # fmt: skip
    return out
