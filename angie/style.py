"""Styles: whose way of gesturing a joint model takes.

A style is a training speaker's embedding in the GPT and nothing else. Pose, place and size stay
those of the photo, or of whatever motion begins with; drawing a stranger toward the rest pose of
the training speaker would move the body to where that one sat.
"""

from angie.bundle import Bundle
from data_prep.errors import BadInput


def styles(bundle: Bundle) -> tuple[str, ...]:
    """Names of the training speakers that a joint model tells apart; none if it is not joint.

    Raises:
        BadInput: the model is joint, but was not measured on anyone yet.
    """
    return bundle.statistics().speakers if bundle.preset.gpt.joint else ()


def check_style(bundle: Bundle, style: str | None) -> None:
    """Refuse a style that a bundle does not have, before anything long begins.

    Args:
        bundle: a speaker bundle.
        style: name of a training speaker; None asks for nothing.

    Raises:
        BadInput: an unknown name, or a model that knows but one style.
    """
    if style is None:
        return
    if not bundle.preset.gpt.joint:
        raise BadInput(
            f"--style {style}: {bundle.folder} has one style alone; "
            "models trained with gpt.joint=true have one for each speaker"
        )
    bundle.statistics().place_of(style)
