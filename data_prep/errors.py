"""The one exception that means "what you gave cannot be used", and how a script reports it.

Notes on what is used although something about it is odd.
"""

import sys
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from numbers import Integral
from pathlib import Path


class BadInput(Exception):
    """Input that cannot be used; the message is one line: the file, what is wrong, the remedy.

    The command prints the message and exits with status 2. Anything else that escapes is a bug.
    """


class Cancelled(Exception):
    """Work was stopped because nobody wants it any more; see `data_prep.progress.listening`."""


class Note(UserWarning):
    """What was odd about an input that is used all the same, and what was done; one line."""


def note(text: str) -> None:
    """Warn of what was odd about an input; the command prints it as a line of its own."""
    warnings.warn(Note(text), stacklevel=3)


@contextmanager
def collected_notes() -> Iterator[list[str]]:
    """Keep the notes of the block, each text once, in the list that is yielded after it."""
    texts: list[str] = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", Note)
        try:
            yield texts
        finally:
            texts.extend(dict.fromkeys(str(one.message) for one in caught))


def check_choice(option: str, given: object, choices: Iterable[str]) -> None:
    """Refuse what is none of the choices of an option.

    Raises:
        BadInput: the option, what was given, and the choices.
    """
    if given not in (known := list(choices)):
        raise BadInput(f"{option} {given}: choose from {', '.join(known)}")


def check_seed(seed: object) -> None:
    """Refuse what is no seed.

    Raises:
        BadInput: not a whole number from 0 on that fits 31 bits.
    """
    if not isinstance(seed, Integral) or not 0 <= int(seed) < 2**31:
        raise BadInput(f"--seed {seed}: give a whole number from 0 to {2**31 - 1}")


def call_script(main: Callable[[], None]) -> None:
    """Call `main` of a script; bad input is one line on standard error and exit status 2."""
    try:
        main()
    except BadInput as error:
        print(f"{Path(sys.argv[0]).name}: {error}", file=sys.stderr)
        sys.exit(2)
