"""Video files: what they hold, and their frames at a constant rate."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import av
import cv2
import numpy as np
from av.container import InputContainer
from av.video.frame import VideoFrame
from av.video.reformatter import VideoReformatter
from av.video.stream import VideoStream

from data_prep.errors import BadInput, note
from data_prep.media.container import TOLERANCE, Damage, check_jump, decode, open_media
from data_prep.media.sound_track import sound_track
from data_prep.media.writer import VideoWriter
from data_prep.rates import FPS

__all__ = ["VideoInfo", "VideoWriter", "probe", "read_frames", "read_grey"]
_STILL_CODECS = ("mjpeg", "png", "bmp", "gif", "webp")
_ROUNDING = 1.5e-3
"""Seconds by which containers round timestamps (Matroska keeps milliseconds)."""

_BT709, _UNSPECIFIED, _BT601 = 1, 2, 5
_LIMITED_RANGE, _FULL_RANGE = 1, 2
_HD_HEIGHT = 720


@dataclass(frozen=True)
class VideoInfo:
    """What a video file holds.

    Attributes:
        width: pixels across, upright and with square pixels, as `read_frames` gives them.
        height: pixels down.
        fps: mean frame rate of the file.
        duration: seconds of picture, as the file declares it.
        has_sound: whether there is a sound track.
        start: presentation time of the first frame in seconds; `origin` for `read_sound`.
        sound_tracks: number of sound tracks.
        sound_track: the one of them, from 0, that is taken (see `sound_track.sound_track`).
    """

    width: int
    height: int
    fps: float
    duration: float
    has_sound: bool
    start: float
    sound_tracks: int = 1
    sound_track: int = 0


def _picture_stream(path: Path, container: InputContainer) -> VideoStream:
    """The first stream of moving pictures; cover art does not count."""
    for stream in container.streams.video:
        context = stream.codec_context
        still = context is not None and context.name in _STILL_CODECS
        if context is not None and not (still and not stream.average_rate):
            context.thread_type = "AUTO"
            return stream
    raise BadInput(f"{path}: has no moving picture; give a video")


def _decode(path: Path, container: InputContainer, stream: VideoStream) -> Iterator[VideoFrame]:
    """Frames of a stream; what is damaged is passed over, and noted once all has been read."""
    damage = Damage()
    for frame in decode(container, stream, damage):
        if isinstance(frame, VideoFrame) and frame.width and frame.height:
            yield frame
    damage.check(path, "picture")
    if damage.seconds > TOLERANCE:
        note(f"{path}: {damage.seconds:.1f} s of the picture are damaged and left out")


def _quarter_turns(frame: VideoFrame) -> int:
    """Quarter turns counterclockwise that put the frame upright."""
    return round(frame.rotation / 90) % 4


def _square_pixel_width(stream: VideoStream, width: int) -> int:
    aspect = stream.sample_aspect_ratio
    return round(width * aspect) if aspect else width


_BYTE_LUMA = ("yuv420p", "yuvj420p", "yuv422p", "yuvj422p", "yuv444p", "yuvj444p", "nv12")
"""Formats whose first plane is the grey picture, a byte a pixel."""

_WIDER = np.clip(np.rint((np.arange(256) - 16) * (255 / 219)), 0, 255).astype(np.uint8)
"""Limited range as full range."""


def _luma(frame: VideoFrame, full: bool) -> np.ndarray:
    """The grey picture of a frame that holds it, in full range: a quarter of a conversion."""
    plane = frame.planes[0]
    rows = np.frombuffer(memoryview(plane), np.uint8).reshape(plane.height, plane.line_size)
    return rows[:, : plane.width].copy() if full else cv2.LUT(rows[:, : plane.width], _WIDER)


def _turned(pixels: np.ndarray, frame: VideoFrame) -> np.ndarray:
    turns = _quarter_turns(frame)
    return np.ascontiguousarray(np.rot90(pixels, turns)) if turns else pixels


class _Converter:
    """Converts frames to upright pixels, with the colour matrix that their tags (or size) imply.

    Attributes:
        format: "rgb24" or "gray".
        longest: pixels of the longer side that larger pictures are reduced to, or None.

    A stream may change its size on the way (calls over a network do): all come at the first's.
    """

    def __init__(self, stream: VideoStream, format: str = "rgb24", longest: int | None = None):
        self.format = format
        self.longest = longest
        self._stream = stream
        self._size: tuple[int, int] | None = None
        self._reformatter = VideoReformatter()

    def __call__(self, frame: VideoFrame) -> np.ndarray:
        matrix = int(frame.colorspace)
        if matrix in (0, _UNSPECIFIED):
            matrix = _BT709 if frame.height >= _HD_HEIGHT else _BT601
        full = int(frame.color_range) == _FULL_RANGE or frame.format.name.startswith("yuvj")
        if self._size is None:
            self._size = (_square_pixel_width(self._stream, frame.width), frame.height)
        width, height = self._size
        if self.longest is not None:
            scale = min(1.0, self.longest / max(width, height))
            width, height = (max(round(side * scale), 2) for side in (width, height))
        same = (width, height) == (frame.width, frame.height)
        if self.format == "gray" and same and frame.format.name in _BYTE_LUMA:
            return _turned(_luma(frame, full), frame)
        pixels = self._reformatter.reformat(
            frame,
            width=width,
            height=height,
            format=self.format,
            src_colorspace=matrix,
            dst_colorspace=_BT601,  # has no effect on RGB; it must only differ from the source's
            src_color_range=_FULL_RANGE if full else _LIMITED_RANGE,
            dst_color_range=_FULL_RANGE,
            interpolation="AREA" if self.longest is not None else None,
        ).to_ndarray()
        return _turned(pixels, frame)


def probe(path: Path) -> VideoInfo:
    """Look at a video file without decoding more than its first frame.

    Raises:
        BadInput: missing, a folder, 0 bytes, not media, without moving picture, or damaged.
    """
    path = Path(path)
    with open_media(path) as container:
        stream = _picture_stream(path, container)
        frame = next(_decode(path, container, stream), None)
        if frame is None:
            raise BadInput(f"{path}: holds no frames; give another video")
        width, height = _square_pixel_width(stream, frame.width), frame.height
        if _quarter_turns(frame) % 2:
            width, height = height, width
        start = _time(frame, 0.0)
        if stream.duration is not None and stream.time_base is not None:
            duration = float(stream.duration * stream.time_base)
        else:
            duration = (container.duration or 0) / av.time_base
        rate = float(stream.average_rate or stream.guessed_rate or 0)
        tracks = len(container.streams.audio)
    return VideoInfo(width, height, rate, duration, tracks > 0, start, tracks, sound_track(path))


def _time(frame: VideoFrame, otherwise: float) -> float:
    if frame.pts is None or frame.time_base is None:
        return otherwise
    return float(frame.pts * frame.time_base)


def read_frames(
    path: Path, fps: float = FPS, wanted: Sequence[tuple[int, int]] | None = None
) -> Iterator[np.ndarray]:
    """Read a video at a constant rate by presentation time.

    Frame k of the result is what a player shows k / fps seconds after the video's first frame:
    the newest frame whose time has come. Slower sources repeat frames, faster ones skip.

    Args:
        path: any container and codec that FFmpeg decodes; one frame is held at a time.
        fps: frames a second of the result.
        wanted: first and one past the last frame of the parts to yield, in order and apart;
            reading ends with the last. None for all.

    Yields:
        frames `(H, W, 3)` uint8 RGB, upright, with square pixels.

    Raises:
        BadInput: missing, a folder, 0 bytes, not media, without moving picture, or damaged.
    """
    path = Path(path)
    with open_media(path) as container:
        stream = _picture_stream(path, container)
        to_rgb = _Converter(stream)
        index = 0
        for frame, times in _at_constant_rate(path, container, stream, fps):
            rgb = None
            for k in range(index, index + times):
                if wanted is None or any(a <= k < b for a, b in wanted):
                    rgb = to_rgb(frame) if rgb is None else rgb.copy()
                    yield rgb
            index += times
            if wanted is not None and (not wanted or index >= wanted[-1][1]):
                return


def read_grey(path: Path, longest: int, fps: float = FPS) -> Iterator[tuple[np.ndarray, int]]:
    """Read a video's pictures small and without colour, each once.

    Args:
        path: as for `read_frames`.
        longest: pixels of the longer side; smaller pictures stay as they are.
        fps: the rate at which the frames are counted.

    Yields:
        a picture `(H, W)` uint8, upright, with square pixels; and how many frames of
        `read_frames` it fills, at least 1.

    Raises:
        BadInput: as `read_frames`.
    """
    path = Path(path)
    with open_media(path) as container:
        stream = _picture_stream(path, container)
        to_grey = _Converter(stream, "gray", longest)
        for frame, times in _at_constant_rate(path, container, stream, fps):
            if times:
                yield to_grey(frame), times


def _at_constant_rate(
    path: Path, container: InputContainer, stream: VideoStream, fps: float
) -> Iterator[tuple[VideoFrame, int]]:
    """Every decoded frame, and for how many frames of the constant rate it is shown."""
    step = 1.0 / float(stream.average_rate or stream.guessed_rate or fps)
    shown: VideoFrame | None = None
    start = time = 0.0
    count = 0

    def until(end: float) -> int:
        return max(0, math.ceil((end - _ROUNDING - start) * fps - 1e-9) - count)

    for frame in _decode(path, container, stream):
        if shown is None:
            start = time = _time(frame, 0.0)
        else:
            then = _time(frame, time + step)
            check_jump(path, time, then)
            time = max(then, time)
            times = until(time)
            yield shown, times
            count += times
        shown = frame
    if shown is None:
        raise BadInput(f"{path}: holds no frames; give another video")
    yield shown, until(time + _shown_for(shown, step))


def _shown_for(frame: VideoFrame, otherwise: float) -> float:
    """Seconds for which the last frame is shown."""
    duration = getattr(frame, "duration", None)
    if not duration or frame.time_base is None:
        return otherwise
    seconds = float(duration * frame.time_base)
    return seconds if 0 < seconds <= 1 else otherwise
