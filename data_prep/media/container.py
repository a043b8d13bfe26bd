"""Opening media files and decoding them, with every failure reported in one line."""

import io
import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import av
import av.error
from av.audio.stream import AudioStream
from av.container import InputContainer
from av.packet import Packet
from av.video.stream import VideoStream

from data_prep.errors import BadInput
from data_prep.media.kinds import kind_of

_LENIENT: dict[str, Any] = (
    {} if int(av.__version__.split(".")[0]) >= 19 else {"metadata_errors": "replace"}
)
"""Metadata that is not UTF-8 is no reason to refuse a file; PyAV 19 never does."""

MAX_JUMP_AHEAD, MAX_JUMP_BACK = 3600.0, 1.0
"""Seconds by which timestamps may jump; beyond that, files were joined without correcting them."""


_RENUMBER = "-vf setpts=N/FRAME_RATE/TB -af asetpts=N/SR/TB"
"""Lets ffmpeg count frames and samples anew; a copy would lose part of a Matroska file."""


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
            f"repair them with: ffmpeg -i {shlex.quote(path.name)} {_RENUMBER} mended.mkv"
        )


def describe(error: Exception) -> str:
    """The readable part of a decoder's error, on one line."""
    text = getattr(error, "strerror", None) or str(error)
    return " ".join(str(text).split()).rstrip(".") or type(error).__name__


class _Span(io.RawIOBase):
    """A part of a file as a file of its own."""

    def __init__(self, path: Path, start: int, stop: int) -> None:
        self._file = path.open("rb")
        self._start, self._length = start, stop - start
        self.seek(0)

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._file.tell() - self._start

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        place = offset + (0, self.tell(), self._length)[whence]
        return self._file.seek(self._start + max(place, 0)) - self._start

    def read(self, size: int | None = -1) -> bytes:
        left = max(self._length - self.tell(), 0)
        return self._file.read(left if size is None or size < 0 else min(size, left))

    def close(self) -> None:
        self._file.close()
        super().close()


@contextmanager
def open_media(path: Path, span: tuple[int, int] | None = None) -> Iterator[InputContainer]:
    """Open a media file for decoding and close it when the block ends.

    Only the local file itself is read: a playlist that points elsewhere is not followed.

    Args:
        path: the file.
        span: first and one past the last byte of the part that is a file of its own; None for
            the whole.

    Raises:
        BadInput: as `check_file`, or the file is not media.
    """
    path = Path(path)
    check_file(path)
    options = {"protocol_whitelist": "file"}
    file = None if span is None else _Span(path, *span)
    try:
        container = av.open(file or f"file:{path}", mode="r", options=options, **_LENIENT)
    except (av.error.FFmpegError, OSError, ValueError, LookupError) as error:
        what = kind_of(path)
        if "video" in what or "recording" in what or not what:
            what = f"not a recording or video that can be read ({describe(error)})"
        else:
            what = f"not a recording or video but {what}"
        raise BadInput(f"{path}: {what}") from error
    with container:
        yield container


@dataclass
class Damage:
    """What could not be decoded of a stream.

    Attributes:
        good: packets that could be decoded.
        bad: packets that could not; players pass over them.
        seconds: of them, as far as they tell.
        error: what the decoder said last.
    """

    good: int = 0
    bad: int = 0
    seconds: float = 0.0
    error: str = ""

    def add(self, error: Exception, packet: Packet | None = None) -> None:
        """Count a packet that could not be decoded."""
        self.bad += 1
        self.error = describe(error)
        if packet is not None and packet.duration and packet.time_base:
            self.seconds += float(packet.duration * packet.time_base)

    def check(self, path: Path, what: str) -> None:
        """Refuse what is mostly damage.

        Raises:
            BadInput: more could not be decoded than could.
        """
        if self.bad and self.bad >= self.good:
            raise BadInput(
                f"{path}: the {what} is damaged ({self.error}); copy, export or convert it again"
            )


TOLERANCE = 0.25
"""Seconds that may be missing without a word, whatever the container."""


def decode(
    container: InputContainer, stream: AudioStream | VideoStream, damage: Damage
) -> Iterator[Any]:
    """Frames of a stream; what cannot be decoded is passed over, as players do.

    Args:
        container: open.
        stream: one of its streams.
        damage: counts what is passed over.
    """
    packets = container.demux(stream)
    while True:
        try:
            packet = next(packets, None)
        except (av.error.FFmpegError, OSError, ValueError) as error:
            damage.add(error)  # the file ends here
            packet = None
        if packet is None:
            return
        try:
            frames = packet.decode()
        except (av.error.FFmpegError, OSError, ValueError) as error:
            damage.add(error, packet)
            continue
        damage.good += 1
        yield from frames
