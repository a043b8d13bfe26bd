"""Opening media files, with every failure reported in one line."""

import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import av
import av.error
from av.container import InputContainer

from data_prep.errors import BadInput

_LENIENT: dict[str, Any] = (
    {} if int(av.__version__.split(".")[0]) >= 19 else {"metadata_errors": "replace"}
)
"""Metadata that is not UTF-8 is no reason to refuse a file; PyAV 19 never does."""

MAX_JUMP_AHEAD, MAX_JUMP_BACK = 3600.0, 1.0
"""Seconds by which timestamps may jump; beyond that, files were joined without correcting them."""


def check_file(path: Path) -> None:
    """Refuse a path that is no readable, non-empty file.

    Raises:
        BadInput: missing, a folder, a pipe or device, unreadable, or 0 bytes.
    """
    path = Path(path)
    if not path.exists():
        raise BadInput(f"{path}: no such file; check the name")
    if path.is_dir():
        raise BadInput(f"{path}: is a folder; name a file")
    if not path.is_file():
        raise BadInput(f"{path}: is a pipe or a device; save it as a file first")
    try:
        with path.open("rb") as file:
            empty = not file.read(1)
    except OSError as error:
        raise BadInput(f"{path}: cannot be read ({error.strerror})") from error
    if empty:
        raise BadInput(f"{path}: is empty (0 bytes); copy or record it again")


def check_jump(path: Path, before: float, after: float) -> None:
    """Refuse timestamps, in seconds, that leap as where files were joined end to end.

    Raises:
        BadInput: further ahead, or back, than any pause or wrong order explains.
    """
    if after - before > MAX_JUMP_AHEAD or before - after > MAX_JUMP_BACK:
        raise BadInput(
            f"{path}: its timestamps jump (from {before:.1f} to {after:.1f} s); "
            f"repair them with: ffmpeg -i {shlex.quote(path.name)} -c copy mended.mkv"
        )


def describe(error: Exception) -> str:
    """The readable part of a decoder's error, on one line."""
    text = getattr(error, "strerror", None) or str(error)
    return " ".join(str(text).split()).rstrip(".") or type(error).__name__


@contextmanager
def open_media(path: Path) -> Iterator[InputContainer]:
    """Open a media file for decoding and close it when the block ends.

    Only the local file itself is read: a playlist that points elsewhere is not followed.

    Raises:
        BadInput: as `check_file`, or the file is not media.
    """
    path = Path(path)
    check_file(path)
    options = {"protocol_whitelist": "file"}
    try:
        container = av.open(f"file:{path}", mode="r", options=options, **_LENIENT)
    except (av.error.FFmpegError, OSError, ValueError) as error:
        what = describe(error)
        raise BadInput(f"{path}: not a recording or video that can be read ({what})") from error
    with container:
        yield container
