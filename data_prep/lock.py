"""A lock on a folder that ends with the process, however that ends."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from data_prep.errors import BadInput

LOCK = ".lock"


def _take(file: IO[bytes]) -> None:
    if sys.platform == "win32":
        import msvcrt

        msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
    else:
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


@contextmanager
def locked(folder: Path, what: Path) -> Iterator[None]:
    """Hold the lock of a folder while the block runs.

    Args:
        folder: that is worked in.
        what: to name in the message.

    Raises:
        BadInput: another process holds it.
    """
    with (folder / LOCK).open("wb") as file:
        try:
            _take(file)
        except OSError as error:
            raise BadInput(f"{what}: another run is making it; wait until it has ended") from error
        yield
