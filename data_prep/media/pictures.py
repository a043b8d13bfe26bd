"""Videos without sound: an animated GIF, and a folder of numbered PNG files."""

from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import av
import cv2
import numpy as np
from av.video.frame import VideoFrame
from numpy.typing import NDArray
from PIL import Image

from data_prep.rates import FPS

COLOURS = 256
"""Of a GIF: those that fit its first frame best."""

_TRAILER = b"\x3b"
_COMMENT = b"\x21\xfe"


class GifWriter:
    """Writes an animated GIF that repeats for ever, frame by frame; a context manager.

    All frames have the colours of the first one, dithered, so that nothing has to be held.
    """

    cut = False

    def __init__(self, path: Path, size: tuple[int, int], comment: str = "") -> None:
        """Open the file.

        Args:
            path: the GIF to write.
            size: width and height in pixels.
            comment: kept in the file, see `read_comment`.
        """
        self._path, self._comment, self._count = path, comment, 0
        self._colours: Image.Image | None = None
        self._container = av.open(f"file:{path}", mode="w", format="gif")
        self._stream = self._container.add_stream("gif", rate=FPS)
        self._stream.width, self._stream.height = size
        self._stream.pix_fmt = "pal8"

    def write(self, frame: NDArray) -> None:
        """Append one frame (H, W, 3) uint8 RGB."""
        image = Image.fromarray(frame)
        if self._colours is None:
            self._colours = image.quantize(COLOURS, Image.Quantize.MEDIANCUT)
        drawn = image.quantize(palette=self._colours, dither=Image.Dither.FLOYDSTEINBERG)
        indices: Any = (np.asarray(drawn), self._palette())
        picture = VideoFrame.from_ndarray(indices, "pal8")
        picture.pts, picture.time_base = self._count, Fraction(1, FPS)
        self._container.mux(self._stream.encode(picture))
        self._count += 1

    def _palette(self) -> NDArray[np.uint8]:
        """Colours (256, 4): opacity, red, green, blue."""
        assert self._colours is not None
        flat = self._colours.getpalette() or []
        palette = np.full((COLOURS, 4), 255, np.uint8)
        palette[: len(flat) // 3, 1:] = np.array(flat, np.uint8).reshape(-1, 3)
        return palette

    def __enter__(self) -> Self:
        """Return the writer itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Finish the file."""
        if kind is None:
            self._container.mux(self._stream.encode(None))
        self._container.close()
        if kind is None and self._comment:
            _append_comment(self._path, self._comment.encode())


def _append_comment(path: Path, text: bytes) -> None:
    """Put a comment extension (GIF89a, section 24) before the end of the file."""
    with path.open("r+b") as file:
        file.seek(-1, 2)
        if file.read(1) != _TRAILER:
            raise ValueError(f"{path}: does not end as a GIF does")
        file.seek(-1, 2)
        blocks = (text[i : i + 255] for i in range(0, len(text), 255))
        file.write(_COMMENT + b"".join(bytes([len(b)]) + b for b in blocks) + b"\x00" + _TRAILER)


def read_comment(path: Path) -> str:
    """The comment that `GifWriter` put at the end of a GIF, or nothing."""
    data = Path(path).read_bytes()
    start = data.rfind(_COMMENT)
    text, at = b"", start + len(_COMMENT)
    while start >= 0 and at < len(data) and data[at]:
        text += data[at + 1 : at + 1 + data[at]]
        at += 1 + data[at]
    return text.decode(errors="replace") if data[at + 1 :] == _TRAILER else ""


class FrameFolder:
    """Writes frames as 000001.png and so on into a folder that is there; a context manager."""

    cut = False

    def __init__(self, folder: Path) -> None:
        self._folder, self._count = folder, 0

    def write(self, frame: NDArray) -> None:
        """Append one frame (H, W, 3) uint8 RGB."""
        self._count += 1
        coded, data = cv2.imencode(".png", cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
        if not coded:
            raise OSError(f"{self._folder}: frame {self._count} could not be encoded")
        (self._folder / f"{self._count:06d}.png").write_bytes(data.tobytes())

    def __enter__(self) -> Self:
        """Return the writer itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Nothing is left to write."""
