"""`angie study`: a page for people to compare videos, and the counting of what they said."""

from pathlib import Path
from typing import Annotated

import typer

from angie.commands.options import Force, Seed
from data_prep.errors import BadInput


def study(
    place: Annotated[
        Path,
        typer.Argument(
            metavar="REPORT", help="Report of angie evaluate with videos; with --answers a study."
        ),
    ],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder of the study.")
    ] = None,
    rows: Annotated[
        str | None,
        typer.Option(help="Rows of the report to compare, with commas; by default all systems."),
    ] = None,
    answers: Annotated[
        Path | None, typer.Option(help="Folder with the files of participants: count them.")
    ] = None,
    seed: Seed = 0,
    force: Force = False,
) -> None:
    """Ask people which of two videos is more real, in time and varied; count their answers."""
    from angie.evaluation.study import count_answers, in_words, make_study

    if answers is not None:
        if output is not None or rows is not None:
            raise BadInput("--answers: counts the answers to STUDY; it takes no -o and no --rows")
        print(in_words(count_answers(place, answers, seed)))
        return
    if output is None:
        raise BadInput("--output: name the folder of the study, -o STUDY")
    chosen = None if rows is None else [name.strip() for name in rows.split(",")]
    print(make_study(place, output, rows=chosen, seed=seed, force=force))
