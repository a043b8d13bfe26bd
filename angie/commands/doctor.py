"""The command that looks at the machine: doctor."""

from pathlib import Path
from typing import Annotated

import typer

from angie import __version__
from angie.commands.options import Device


def doctor(
    speaker: Annotated[
        Path | None, typer.Option(help="Speaker bundle; the shipped one by default.")
    ] = None,
    device: Device = "auto",
) -> None:
    """Show what this machine has, how fast it draws, and what to do where something is missing.

    Exit status 1 if there is something to do.
    """
    from angie.doctor import findings

    print(f"{'angie':12} {__version__}", flush=True)
    todo = []
    for one in findings(speaker, device):
        print(f"{one.name:12} {one.found}", flush=True)
        if one.advice:
            todo.append(f"{one.name}: {one.advice}")
    print("\n".join(["to do:", *(f"- {line}" for line in todo)] if todo else ["all is well"]))
    if todo:
        raise typer.Exit(1)
