"""A few frames of a video side by side, with the crop drawn: what was seen, at a glance."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import av
import av.error
import cv2
import imageio.v3 as iio
import numpy as np
from av.video.frame import VideoFrame

from data_prep.errors import BadInput
from data_prep.media.container import open_media
from data_prep.prepare.source import Outcome
from data_prep.rates import FPS

FRAMES = 6
"""Frames of a sheet, from the middles of as many equal parts of the video."""

HEIGHT = 180
"""Of a sheet in pixels."""

_JUMP = 10.0
"""Seconds ahead from which on a video is searched rather than decoded through."""

_USED, _REFUSED = (80, 220, 80), (235, 60, 60)
_QUALITY = 78


def write_sheet(path: Path, outcome: Outcome) -> int:
    """Write the contact sheet of a video as JPEG.

    The crop is drawn in green; a frame of a part that was refused has a red border.

    Args:
        path: the file to write.
        outcome: of the video.

    Returns:
        size of the file in bytes; 0, and no file, where no frame could be had.
    """
    if outcome.info is None or outcome.info.duration <= 0:
        return 0
    step = outcome.info.duration / FRAMES
    times = [(number + 0.5) * step for number in range(FRAMES)]
    small = (max(2, round(HEIGHT * outcome.info.width / outcome.info.height)), HEIGHT)
    tiles = [
        _tile(picture, time, outcome)
        for time, picture in _pictures(outcome.source.path, times, outcome.info.start, small)
    ]
    if not tiles:
        return 0
    iio.imwrite(path, np.hstack(tiles), extension=".jpg", quality=_QUALITY)
    return path.stat().st_size


def _pictures(
    path: Path, times: Sequence[float], origin: float, size: tuple[int, int]
) -> Iterator[tuple[float, np.ndarray]]:
    """The first frame at or after each time, upright, RGB; what cannot be decoded is left out."""
    try:
        with open_media(path) as container:
            stream = container.streams.video[0]
            stream.codec_context.thread_type = "AUTO"
            frames = container.decode(stream)
            now = 0.0
            for time in times:
                if time - now > _JUMP and stream.time_base is not None:
                    container.seek(round((time + origin) / stream.time_base), stream=stream)
                    frames = container.decode(stream)
                for frame in frames:
                    now = (frame.time or 0.0) - origin
                    if now >= time - 0.5 / FPS:
                        yield now, _upright(frame, size)
                        break
    except (BadInput, av.error.FFmpegError, OSError, ValueError, IndexError):
        return  # the sheet ends where the picture is damaged; the outcome says so


def _upright(frame: VideoFrame, size: tuple[int, int]) -> np.ndarray:
    turns = round(frame.rotation / 90) % 4
    width, height = size[::-1] if turns % 2 else size
    picture = frame.reformat(width=width, height=height, format="rgb24").to_ndarray()
    return np.ascontiguousarray(np.rot90(picture, turns))


def _tile(picture: np.ndarray, time: float, outcome: Outcome) -> np.ndarray:
    assert outcome.info is not None
    height, width = picture.shape[:2]
    frame = round(time * FPS)
    span = next((span for span in outcome.spans if span.first <= frame < span.stop), None)
    if span is not None and span.crop is not None:
        scale = height / outcome.info.height
        corner = round(span.crop.x * scale), round(span.crop.y * scale)
        side = round(span.crop.size * scale)
        other = corner[0] + side - 1, corner[1] + side - 1
        cv2.rectangle(picture, corner, other, _USED, 2)
    if outcome.refused is not None or (span is not None and span.reason is not None):
        cv2.rectangle(picture, (1, 1), (width - 2, height - 2), _REFUSED, 3)
    text = f"{int(time // 60)}:{time % 60:04.1f}"
    for colour, thickness in (((0, 0, 0), 3), ((255, 255, 255), 1)):
        where = (6, height - 8)
        font = cv2.FONT_HERSHEY_SIMPLEX
        cv2.putText(picture, text, where, font, 0.42, colour, thickness, cv2.LINE_AA)
    return picture
