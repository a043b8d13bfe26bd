"""The paper's Table 3 as text: motion, pictures of whole clips, pictures of their beginnings.

A variant that was trained with several seeds has one row: the mean over its trainings, each the
mean over its runs, and half of the 95 % interval over them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from angie.evaluation.images import FROM_SOUND
from angie.evaluation.scoring import summarise
from angie.metrics.score import Score

MOTION = ("fgd", "fgd_raw", "bc", "pmb", "diversity_ha2g", "jerk")
"""Columns of what is generated from the sound; FGD in its features and in raw space."""

PICTURES = ("l1", "perceptual", "aed", "l1_drawn", "perceptual_drawn")
"""Columns of pictures of reconstructed motion; the last two leave the renderer's part out."""

SOUND = ("l1", "perceptual", "aed")
"""Columns of pictures of motion that is generated from the sound."""

EARLY = 2.0
"""Seconds of the beginnings of clips, the second of the two protocols."""


@dataclass(frozen=True)
class Trained:
    """A variant as it was trained.

    Attributes:
        rows: names of its rows in the report, one for each seed of training.
        shares: further columns: shares of the frames, by title.
        steps: at which each stage stopped, by its name, of the first training.
    """

    rows: Sequence[str]
    shares: Mapping[str, float]
    steps: Mapping[str, int]


def tables(
    whole: Mapping[str, Any], early: Mapping[str, Any] | None, variants: Mapping[str, Trained]
) -> str:
    """All tables as Markdown.

    Args:
        whole: what `angie.evaluation.evaluate` returned of whole clips, of one space.
        early: the same of the first two seconds; None where there are no pictures.
        variants: by name, in the order of the table.
    """
    parts = ["Motion from the sound", "", motion(whole, variants)]
    for title, numbers in (
        ("Pictures of whole clips", whole),
        (f"Pictures of the first {EARLY:g} s", early),
    ):
        if numbers is not None and numbers["spaces"][0]["images"]:
            parts += ["", title, "", pictures(numbers, variants)]
    return "\n".join(parts)


def motion(numbers: Mapping[str, Any], variants: Mapping[str, Trained]) -> str:
    """Scores of motion, the rows of reference first; where training stopped last."""
    space = numbers["spaces"][0]
    scores = {row["name"]: row["scores"] for row in space["rows"]}
    shares = list(dict.fromkeys(t for v in variants.values() for t in v.shares))
    lines = [["", *(_titles(numbers)[key] for key in MOTION), *shares, "steps"]]
    for name, made in _rows(scores, variants).items():
        variant = variants.get(name)
        cells = [name, *(_cell(numbers, scores, made, key) for key in MOTION)]
        for title in shares:
            share = None if variant is None else variant.shares.get(title)
            cells.append("-" if share is None else f"{100 * share:.1f} %")
        steps = {} if variant is None else variant.steps
        lines.append([*cells, ", ".join(f"{k} {n}" for k, n in steps.items()) or "-"])
    return _markdown(lines)


def pictures(numbers: Mapping[str, Any], variants: Mapping[str, Trained]) -> str:
    """Scores of pictures: of reconstructed motion, then of motion from the sound."""
    scores = {row["name"]: row["scores"] for row in numbers["spaces"][0]["images"]["rows"]}
    titles = _titles(numbers)
    head = [titles[key] for key in PICTURES] + [f"{titles[key]}{FROM_SOUND}" for key in SOUND]
    lines = [["", *head]]
    own = {name: row for name, row in scores.items() if not name.endswith(FROM_SOUND)}
    for name, made in _rows(own, variants).items():
        heard = [f"{one}{FROM_SOUND}" for one in made]
        cells = [_cell(numbers, scores, made, key) for key in PICTURES]
        cells += [_cell(numbers, scores, heard, key) for key in SOUND]
        lines.append([name, *cells])
    return _markdown(lines)


def _rows(scores: Mapping[str, Any], variants: Mapping[str, Trained]) -> dict[str, Sequence[str]]:
    """Rows of the table, each with those of the report that it is the mean of."""
    trained = {one for variant in variants.values() for one in variant.rows}
    rows: dict[str, Sequence[str]] = {name: [name] for name in scores if name not in trained}
    return rows | {name: variant.rows for name, variant in variants.items()}


def _titles(numbers: Mapping[str, Any]) -> dict[str, str]:
    return {entry["key"]: entry["title"] for entry in numbers["definitions"]}


def _cell(
    numbers: Mapping[str, Any], scores: Mapping[str, Any], rows: Sequence[str], key: str
) -> str:
    """Mean over trainings and half of its interval, or "-" where a row has no value."""
    found = [scores[row][key]["mean"] if row in scores else None for row in rows]
    values = [value for value in found if value is not None]
    if len(values) < len(found):
        return "-"
    digits = next(entry["digits"] for entry in numbers["definitions"] if entry["key"] == key)
    summary = summarise([Score(value) for value in values])
    half = "" if summary.interval is None else f" ± {summary.interval:.{digits}f}"
    return f"{summary.mean:.{digits}f}{half}"


def _markdown(lines: list[list[str]]) -> str:
    rows = [lines[0], ["---"] * len(lines[0]), *lines[1:]]
    return "\n".join("| " + " | ".join(line) + " |" for line in rows)
