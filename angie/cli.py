"""The `angie` command."""

import gc
import io
import os
import signal
import sys
import warnings
from typing import Annotated

# How threads of GNU OpenMP wait for the next parallel loop, before torch is imported: those that
# spin starve a shared machine, so they sleep; but not before some 100 microseconds: from one
# product of a transformer to the next they stay awake, which takes a quarter off its time.
os.environ.update({"OMP_WAIT_POLICY": "PASSIVE", "GOMP_SPINCOUNT": "10000", **os.environ})

import typer  # noqa: E402

from angie import __version__
from angie.commands.animate import animate, demo
from angie.commands.doctor import doctor
from angie.commands.evaluate import evaluate
from angie.commands.motion import ablate, codebook, gestures
from angie.commands.origin import verify
from angie.commands.prepare import phantom, prepare
from angie.commands.serve import app as page
from angie.commands.serve import serve
from angie.commands.study import study
from angie.commands.train import import_mraa, info, teach, train
from data_prep.errors import BadInput, Note
from data_prep.progress import console

UsageError: type[Exception] = typer.BadParameter.__mro__[1]
"""What every wrong use of the command line is; where Typer keeps it depends on the version."""

FEW_COLLECTIONS = 100_000
"""Objects between collections of garbage: the libraries make a million that stay, and looking
through them again and again took a sixth of the time to the first frame."""

INTERRUPTED = 128 + signal.SIGINT
"""Exit status after Ctrl-C."""


class Interrupt(KeyboardInterrupt):
    """Ctrl-C, with a status.

    A plain one that meets code made of text, which modules with dataclasses run while they are
    loaded, makes Python end by the signal, whatever becomes of it.
    """

    came = False
    """Whether there was one: libraries that it meets while they are loaded fail as they like."""


def _interrupt(*_: object) -> None:
    Interrupt.came = True
    raise Interrupt


app = typer.Typer(
    help="One photo of a speaker and a speech recording in, a video of that person gesturing out.",
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

for command in (
    animate,
    demo,
    phantom,
    prepare,
    teach,
    train,
    evaluate,
    ablate,
    study,
    import_mraa,
    gestures,
    codebook,
    info,
    verify,
    doctor,
    serve,
):
    app.command()(command)
app.command("app")(page)


@app.callback(invoke_without_command=True)
def bare(
    context: typer.Context,
    show: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    """One photo of a speaker and a speech recording in, a video of that person gesturing out."""
    if show:
        print(f"angie {__version__}")
        raise typer.Exit
    if context.invoked_subcommand is None:
        print(context.get_help(), file=sys.stderr)
        raise typer.Exit(2)


def main() -> None:
    """Run the command; bad input is one line on standard error and exit status 2."""
    gc.set_threshold(FEW_COLLECTIONS)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # what is half-written is removed
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # else it is not wanted
        signal.signal(signal.SIGINT, _interrupt)
    for stream in (sys.stdout, sys.stderr):  # file names may be no text
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    Interrupt.came = False
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what libraries warn of is not the user's to mend
        warnings.simplefilter("always", Note)
        shown: set[str] = set()
        warnings.showwarning = lambda message, *_, **__: _show_once(str(message), shown)
        status, text = _run()
    if text:
        _show(text, "red")
    if status:
        sys.exit(status)


def _show(text: str, style: str | None = None) -> None:
    line = f"angie: {' '.join(text.splitlines())}"
    console.print(line, style=style, highlight=False, markup=False, soft_wrap=True)


def _show_once(text: str, shown: set[str]) -> None:
    if text not in shown:
        shown.add(text)
        _show(text)


def _run() -> tuple[int, str]:
    """Exit status of the command, and the line that tells what went wrong, or nothing."""
    try:
        status = app(standalone_mode=False) or 0  # of typer.Exit; commands return None
    except BadInput as error:
        return 2, str(error)
    except UsageError as error:
        return 2, f"{_usage(error)} (see {_place()} --help)"
    except OSError as error:  # disk full, no permission, a name that is too long ...
        place = f"{error.filename}: " if error.filename else ""
        reason = error.strerror or str(error)
        if "requested and" in reason:  # of NumPy, which does not say why
            reason = f"could not be written whole; is the disk full? ({reason})"
        return 2, f"{place}{reason}"
    except (KeyboardInterrupt, typer.Abort):  # Typer makes a status of it, but not everywhere
        status = INTERRUPTED
    except Exception:
        if not Interrupt.came:
            raise
        status = INTERRUPTED
    return status, "interrupted" if status == INTERRUPTED else ""


def _usage(error: Exception) -> str:
    """What was wrong with the command line, such as "no such option: --sped"."""
    text: str = error.format_message().strip().rstrip(".")  # type: ignore[attr-defined]
    return text[:1].lower() + text[1:]


def _place() -> str:
    """The command whose help tells what would be right, such as "angie animate"."""
    names = [one.callback.__name__ for one in app.registered_commands if one.callback]
    return " ".join(["angie", *(word for word in sys.argv[1:2] if word.replace("-", "_") in names)])


if __name__ == "__main__":
    main()
