"""What the columns of the report mean: title, unit, direction, formula, source."""

from dataclasses import dataclass
from pathlib import Path

import yaml

from data_prep.rates import IMAGE_SIZE

BETTER = {
    "high": "higher is better",
    "low": "lower is better",
    "truth": "nearest to the truth is best",
}


@dataclass(frozen=True)
class Definition:
    """One column.

    Attributes:
        key: its name in the files.
        title: its name in the tables.
        better: which values are better.
        text: formula, constants and source.
        unit: of the values; empty for a plain number.
        digits: after the point, in tables.
    """

    key: str
    title: str
    better: str
    text: str
    unit: str = ""
    digits: int = 3


PIXEL = IMAGE_SIZE / 2
"""Pixels of one normalised unit."""


def _columns(section: str) -> tuple[Definition, ...]:
    """The columns of a section of `definitions.yaml`."""
    found = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text("utf-8"))[section]
    return tuple(
        Definition(
            **{
                **entry,
                "better": BETTER[entry["better"]],
                "text": entry["text"].format(pixel=f"{PIXEL:g}"),
            }
        )
        for entry in found
    )


MOTION, IMAGES, PEOPLE = (_columns(part) for part in ("motion", "images", "people"))

SHORT = ("fgd", "fgd_raw", "bc", "pmb", "diversity", "hellinger", "maje_px", "cca_global")
"""Columns that the terminal shows."""

ALL = (*MOTION, *IMAGES, *PEOPLE)
