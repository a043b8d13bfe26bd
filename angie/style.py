"""Styles: whose way of gesturing a generator takes.

A style is what a generator has learnt of a training speaker and nothing else. Pose, place and size
stay those of the photo, or of whatever motion begins with; drawing a stranger toward the rest pose
of the training speaker would move the body to where that one sat.
"""

from angie.bundle import Bundle
from angie.generators import family
from angie.generators.base import read_style
from data_prep.errors import BadInput


def styles(bundle: Bundle, generator: str | None = None) -> tuple[str, ...]:
    """Names of the styles that a generator tells apart; none if there is but one.

    Raises:
        BadInput: it tells some apart, but was not measured on anyone yet.
    """
    name = bundle.chosen(generator)
    return family(name).styles(bundle.settings(name), bundle.statistics())


def check_style(bundle: Bundle, style: str | None, generator: str | None = None) -> None:
    """Refuse a style that a bundle does not have, before anything long begins.

    Args:
        bundle: a speaker bundle.
        style: name of a training speaker, or what else `angie.generators.base.read_style` reads.
        generator: whose style.

    Raises:
        BadInput: an unknown name, or a model that knows but one style.
    """
    if style is None:
        return
    if not styles(bundle, generator):
        advice = family(bundle.chosen(generator)).style_advice
        more = f"; models trained with {advice} have one for each speaker" if advice else ""
        raise BadInput(f"--style {style}: {bundle.folder} has one style only{more}")
    name = bundle.chosen(generator)
    size = family(name).style_space(bundle.settings(name))
    read_style(style, bundle.statistics().speakers, size)
