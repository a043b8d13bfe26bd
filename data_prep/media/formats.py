"""Formats that videos are written in: which there are, and what each is made of."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

from numpy.typing import NDArray

from data_prep.errors import BadInput

FORMATS = ("mp4", "webm", "gif", "frames")
"""Names of the formats; "frames" is a folder of PNG files."""


@dataclass(frozen=True)
class Codecs:
    """A file with picture and sound.

    Attributes:
        container: FFmpeg's name.
        picture: encoder of the picture.
        sound: encoder of the sound.
        rates: samples a second that the sound can have, rising.
        options: of the container.
        picture_options: of the picture's encoder.
    """

    container: str
    picture: str
    sound: str
    rates: tuple[int, ...]
    options: Mapping[str, str] = field(default_factory=dict)
    picture_options: Mapping[str, str] = field(default_factory=dict)


MP4 = Codecs(
    "mp4",
    "libx264",
    "aac",
    (8000, 11025, 12000, 16000, 22050, 24000, 32000, 44100, 48000, 64000, 88200, 96000),
    {"movflags": "+faststart"},
    {"preset": "veryfast"},
)
"""At "veryfast", x264 encodes some 200 frames of 256x256 a second on a core, at half the size of
"superfast"."""

WEBM = Codecs(
    "webm",
    "libvpx-vp9",
    "libopus",
    (8000, 12000, 16000, 24000, 48000),
    picture_options={"deadline": "realtime", "cpu-used": "6", "row-mt": "1", "b": "0"},
)
"""VP9 with constant quality."""


class FrameWriter(Protocol):
    """What takes the frames of a video one by one; a context manager.

    Attributes:
        cut: the sound was longer than the picture, and was cut.
    """

    cut: bool

    def write(self, frame: NDArray) -> None:
        """Append one frame (H, W, 3) uint8 RGB."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...


def format_of(path: Path, wanted: str | None = None) -> str:
    """The format of a video to be written: as its name says, or as is wanted.

    Args:
        path: of the video; a folder's name has no ending.
        wanted: one of `FORMATS`, or None.

    Raises:
        BadInput: an unknown format, or a name that ends otherwise.
    """
    if wanted not in (None, *FORMATS):
        raise BadInput(f"--format {wanted}: choose from {', '.join(FORMATS)}")
    ending = Path(path).suffix.lower().removeprefix(".")
    if wanted == "frames":
        if ending in FORMATS:
            raise BadInput(f"{path}: frames are a folder; leave .{ending} off its name")
        return wanted
    if wanted is None and ending in FORMATS[:-1]:
        return ending
    if wanted is None or ending != wanted:
        name = wanted or "mp4"
        article = "an" if name == "mp4" else "a"
        others = "" if wanted else " (.webm and .gif are known too, and --format frames)"
        raise BadInput(
            f"{path}: the video is {article} {name}; let its name end in .{name}{others}"
        )
    return wanted
