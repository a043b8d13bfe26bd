"""The `angie` command."""

import gc
import io
import os
import signal
import sys
from typing import Annotated

from angie.waiting import WAITING

os.environ.update({**WAITING, **os.environ})  # before torch comes

import typer  # noqa: E402

from angie import __version__
from angie.commands.animate import animate, demo
from angie.commands.bundles import import_mraa, info, train
from angie.commands.data import phantom, prepare
from angie.commands.evaluate import evaluate
from angie.commands.motion import ablate, codebook, gestures
from data_prep.errors import BadInput
from data_prep.progress import console

FEW_COLLECTIONS = 100_000
"""Objects between collections of garbage: the libraries make a million that stay, and looking
through them again and again took a sixth of the time to the first frame."""

app = typer.Typer(
    help="One photo of a speaker and a speech recording in, a video of that person gesturing out.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

for command in (
    animate,
    demo,
    phantom,
    prepare,
    train,
    evaluate,
    ablate,
    import_mraa,
    gestures,
    codebook,
    info,
):
    app.command()(command)


@app.callback(invoke_without_command=True)
def version(
    show: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    """One photo of a speaker and a speech recording in, a video of that person gesturing out."""
    if show:
        print(f"angie {__version__}")
        raise typer.Exit


def main() -> None:
    """Run the command; bad input is one line on standard error and exit status 2."""
    gc.set_threshold(FEW_COLLECTIONS)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # what is half-written is removed
    for stream in (sys.stdout, sys.stderr):  # file names may be no text
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    try:
        app()
    except BadInput as error:
        console.print(f"angie: {error}", style="red", highlight=False, markup=False, soft_wrap=True)
        sys.exit(2)
    except OSError as error:  # disk full, no permission, a name that is too long ...
        place = f"{error.filename}: " if error.filename else ""
        text = f"angie: {place}{error.strerror or error}"
        console.print(text, style="red", highlight=False, markup=False, soft_wrap=True)
        sys.exit(2)


if __name__ == "__main__":
    main()
