"""Videos written with their sound as the frames come (mp4 or webm), in a thread or not."""

import contextlib
import itertools
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from fractions import Fraction
from pathlib import Path
from typing import cast

import av
import av.error
import numpy as np
import soxr
from av.audio.frame import AudioFrame
from av.audio.stream import AudioStream
from av.video.frame import VideoFrame
from av.video.reformatter import VideoReformatter
from av.video.stream import VideoStream

from data_prep.media.audio import open_recording
from data_prep.media.formats import MP4, Codecs, FrameWriter
from data_prep.rates import FPS

_AAC_BITS = 6144
"""Most bits that one AAC frame may take for a channel (ISO/IEC 14496-3)."""

_AAC_FRAME = 1024
_AAC_BIT_RATE = 192_000
_BLOCK = 16384

_BT709, _LIMITED_RANGE = 1, 1

_TAGS = {
    **dict.fromkeys(("colorspace", "color_primaries", "color_trc"), "bt709"),
    "color_range": "tv",
}


class VideoWriter:
    """Writes an mp4 (H.264 yuv420p, AAC, faststart) or a webm frame by frame; a context manager.

    The recording is decoded and encoded while the frames come, at its own rate, and whole:
    from its first sample at time 0 to its last. Frame k is shown from k / fps; for a picture
    that ends with its sound, write `ceil(seconds * fps)` frames.

    The file appears at exactly `path`; wrap it in `data_prep.files.whole_file` so that a
    failure leaves nothing behind.
    """

    def __init__(
        self,
        path: Path,
        size: tuple[int, int],
        fps: int = FPS,
        sound: Path | tuple[np.ndarray, int] | None = None,
        comment: str = "",
        crf: int = 18,
        threads: int = 0,
        origin: float | None = None,
        fit: bool = False,
        description: str = "",
        codecs: Codecs = MP4,
    ) -> None:
        """Open the file.

        Args:
            path: the file to write.
            size: width and height in pixels, both even.
            fps: frames a second.
            sound: a recording (or a video, for its sound); or samples `(N,)` or `(N, 2)` float
                in [-1, 1] and their rate; or None for a silent video.
            comment: metadata of the file; marks generated video as such.
            crf: quality, lower is better; of x264, 18 is visually without loss.
            threads: of the picture's encoder, 0 for as many as it likes.
            origin: presentation time in the recording's file that time 0 of this video has (the
                start of that file's pictures, for sound in step with them); None for the
                sound's own first sample.
            fit: end the sound with the picture: cut (then `cut` is set) or padded with silence.
            description: more metadata of the file, of any length.
            codecs: of the format, see `data_prep.media.formats`.

        Raises:
            BadInput: the recording cannot be read (see `read_sound`).
            ValueError: an odd size.
        """
        width, height = size
        if width % 2 or height % 2 or min(size) < 2:
            raise ValueError(f"size {size} must be even for yuv420p")
        self._shape = (height, width, 3)
        self._fps, self._codecs = fps, codecs
        self._count = 0
        self._fit = fit
        self._rest: np.ndarray | None = None
        self.cut = False
        self._reformatter = VideoReformatter()
        self._open = contextlib.ExitStack()
        try:
            rate, channels, self._blocks = self._open_sound(sound, origin)
            options = dict(codecs.options)
            # A name alone may hold a colon, and what is before it would be taken for a protocol.
            self._container = av.open(
                f"file:{path}", mode="w", format=codecs.container, options=options
            )
            self._open.callback(self._container.close)
            if comment:
                self._container.metadata["comment"] = comment
            if description:
                self._container.metadata["description"] = description
            options = {"crf": str(crf), **codecs.picture_options, **_TAGS}
            stream = self._container.add_stream(codecs.picture, rate=fps, options=options)
            self._video = cast(VideoStream, stream)
            self._video.width, self._video.height = width, height
            self._video.pix_fmt = "yuv420p"
            self._video.codec_context.thread_count = threads
            self._audio = self._add_audio(rate, channels) if rate else None
        except BaseException:
            self._open.close()
            raise
        self._samples = 0

    def _open_sound(
        self, sound: Path | tuple[np.ndarray, int] | None, origin: float | None
    ) -> tuple[int, int, Iterator[np.ndarray]]:
        """Rate that the format can carry, channels, and the blocks `(channels, n)` at that rate."""
        if sound is None:
            return 0, 0, iter(())
        if isinstance(sound, tuple):
            samples, rate = sound
            channels = 1 if samples.ndim == 1 else samples.shape[1]
            if channels > 2:
                raise ValueError(f"samples {samples.shape} must be (N,) or (N, 2)")
            blocks = _split(np.asarray(samples, np.float32).reshape(-1, channels).T)
        else:
            recording = self._open.enter_context(open_recording(Path(sound)))
            rate, channels, blocks = recording.rate, recording.channels, recording.blocks()
            lead = 0 if origin is None else round((recording.start - origin) * rate)
            blocks = _led(blocks, lead, channels)
        rates = self._codecs.rates
        target = min((r for r in rates if r >= rate), default=rates[-1])
        return target, channels, blocks if target == rate else _resampled(blocks, rate, target)

    def _add_audio(self, rate: int, channels: int) -> AudioStream:
        layout = "mono" if channels == 1 else "stereo"
        added = self._container.add_stream(self._codecs.sound, rate=rate, layout=layout)
        stream = cast(AudioStream, added)
        most = _AAC_BITS * channels * rate // _AAC_FRAME
        stream.codec_context.bit_rate = min(_AAC_BIT_RATE, int(0.9 * most))
        return stream

    def write(self, frame: np.ndarray) -> None:
        """Append one frame `(H, W, 3)` uint8 RGB, and the sound up to its end.

        Raises:
            ValueError: wrong shape or dtype.
        """
        if frame.shape != self._shape or frame.dtype != np.uint8:
            raise ValueError(f"frame {frame.shape} {frame.dtype} is not {self._shape} uint8")
        picture = self._reformatter.reformat(
            VideoFrame.from_ndarray(np.ascontiguousarray(frame), "rgb24"),
            format="yuv420p",
            dst_colorspace=_BT709,
            dst_color_range=_LIMITED_RANGE,
        )
        picture.pts = self._count
        picture.time_base = Fraction(1, self._fps)
        self._container.mux(self._video.encode(picture))
        self._count += 1
        if self._audio is not None:
            while self._samples * self._fps < self._count * self._audio.rate:
                if not self._write_sound():
                    break

    def _write_sound(self) -> bool:
        """Encode the next block; False when the recording is over."""
        block = self._next_block()
        if block is None or self._audio is None:
            return False
        self._encode_sound(block)
        return True

    def _next_block(self) -> np.ndarray | None:
        """Samples that come next; where the sound has to fit, no more than the picture lasts."""
        block, self._rest = self._rest, None
        if block is None:
            block = next((block for block in self._blocks if block.shape[1]), None)
        if block is not None and self._fit and self._audio is not None:
            room = -(-self._count * self._audio.rate // self._fps) - self._samples
            if block.shape[1] > room:
                block, self._rest = block[:, :room], block[:, room:]
        return block

    def _encode_sound(self, block: np.ndarray) -> None:
        assert self._audio is not None
        sound = np.ascontiguousarray(np.clip(np.nan_to_num(block), -1.0, 1.0), np.float32)
        layout = "mono" if len(sound) == 1 else "stereo"
        frame = AudioFrame.from_ndarray(sound, "fltp", layout)
        frame.sample_rate = self._audio.rate
        frame.pts = self._samples
        frame.time_base = Fraction(1, self._audio.rate)
        self._samples += sound.shape[1]
        self._container.mux(self._audio.encode(frame))

    def _end_sound(self) -> None:
        """Write what is left of the sound; where it has to fit, silence up to the picture's end."""
        if not self._fit:
            while self._write_sound():
                pass
        elif self._audio is not None:
            left = itertools.islice((b for b in self._blocks if b.shape[1]), 1)
            self.cut = self._rest is not None or any(True for _ in left)
            missing = -(-self._count * self._audio.rate // self._fps) - self._samples
            channels = len(self._audio.layout.channels)
            for first in range(0, missing, _BLOCK):
                silence = np.zeros((channels, min(_BLOCK, missing - first)), np.float32)
                self._encode_sound(silence)

    def close(self) -> None:
        """Write what is left of the sound and finish the file."""
        with self._open:
            self._end_sound()
            self._container.mux(self._video.encode(None))
            if self._audio is not None:
                self._container.mux(self._audio.encode(None))

    def __enter__(self) -> "VideoWriter":
        """Return the writer itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        """Finish the file; after an error only let go of it."""
        if kind is None:
            self.close()
            return
        # Report the error under way, not a second one from the unfinished file.
        with contextlib.suppress(av.error.FFmpegError):
            self._open.close()


def _led(blocks: Iterator[np.ndarray], lead: int, channels: int) -> Iterator[np.ndarray]:
    """The same sound after `lead` samples of silence, or without its first `-lead` samples."""
    if lead > 0:
        yield from _split(np.zeros((channels, lead), np.float32))
    skip = max(-lead, 0)
    for block in blocks:
        yield block[:, skip:]
        skip -= min(skip, block.shape[1])


def _split(samples: np.ndarray) -> Iterator[np.ndarray]:
    for start in range(0, samples.shape[1], _BLOCK):
        yield samples[:, start : start + _BLOCK]


def _resampled(blocks: Iterator[np.ndarray], rate: int, target: int) -> Iterator[np.ndarray]:
    """The same sound at another rate, band-limited, neither shifted nor cut."""
    converter = None
    for block in blocks:
        if converter is None:
            converter = soxr.ResampleStream(rate, target, len(block), dtype="float32")
        yield converter.resample_chunk(np.ascontiguousarray(block.T)).reshape(-1, len(block)).T
        channels = len(block)
    if converter is not None:
        tail = converter.resample_chunk(np.zeros((0, channels), np.float32), last=True)
        yield tail.reshape(-1, channels).T


class WriteThread:
    """Hands frames to a writer in a thread of its own; a context manager.

    At most `held` batches wait, so that memory is bounded and a slow encoder slows the caller.
    FFmpeg lets Python go on while it converts and encodes. Leave this block before the writer's.

    Args:
        video: an open writer of any format, not used elsewhere meanwhile.
        held: most batches that wait.
    """

    def __init__(self, video: FrameWriter, held: int = 4) -> None:
        self._video, self._held = video, held
        self._pool = ThreadPoolExecutor(1, "encoder")
        self._waiting: deque[Future[None]] = deque()

    def write(self, frames: np.ndarray) -> None:
        """Append frames `(b, H, W, 3)` uint8 RGB, which must not be changed afterwards.

        Raises:
            BadInput: what the writer raised for earlier frames, such as damaged sound.
        """
        while self._waiting and (len(self._waiting) > self._held or self._waiting[0].done()):
            self._waiting.popleft().result()
        self._waiting.append(self._pool.submit(self._write, frames))

    def _write(self, frames: np.ndarray) -> None:
        for frame in frames:
            self._video.write(frame)

    def __enter__(self) -> "WriteThread":
        """Return the thread itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        """Wait until all is written; after an error only for the batch under way."""
        self._pool.shutdown(cancel_futures=kind is not None)
        while kind is None and self._waiting:
            self._waiting.popleft().result()
