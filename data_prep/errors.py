"""The one exception that means "what you gave cannot be used", and how a script reports it."""

import sys
from collections.abc import Callable
from pathlib import Path


class BadInput(Exception):
    """Input that cannot be used; the message is one line: the file, what is wrong, the remedy.

    The command prints the message and exits with status 2. Anything else that escapes is a bug.
    """


def call_script(main: Callable[[], None]) -> None:
    """Call `main` of a script; bad input is one line on standard error and exit status 2."""
    try:
        main()
    except BadInput as error:
        print(f"{Path(sys.argv[0]).name}: {error}", file=sys.stderr)
        sys.exit(2)
