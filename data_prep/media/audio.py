"""Recordings, by one of a file's sound tracks: a stream at its own rate, or mono samples."""

from array import array
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import av.error
import numpy as np
import soundfile
import soxr
from av.audio.frame import AudioFrame
from av.audio.resampler import AudioResampler
from av.audio.stream import AudioStream
from av.container import InputContainer
from av.stream import Disposition

from data_prep.errors import BadInput
from data_prep.media.container import check_jump, describe, open_media
from data_prep.rates import SAMPLE_RATE

AUDIBLE = 10 ** (-60 / 20)
"""Level, of full scale, that a track must reach somewhere."""

_LISTEN = 120.0
"""Seconds of a track that are listened to at most."""


def sound_track(path: Path) -> int:
    """Choose one of a file's sound tracks: the first that is not silent, the default one first.

    A file with one track is not decoded for it; where all are silent it is the default one.

    Args:
        path: a recording or video.

    Returns:
        number of the track, from 0, among the sound tracks.

    Raises:
        BadInput: as `open_media`.
    """
    with open_media(path) as container:
        tracks = container.streams.audio
        if len(tracks) < 2:
            return 0
        order = sorted(
            range(len(tracks)), key=lambda i: Disposition.default not in tracks[i].disposition
        )
    return next((track for track in order if _is_audible(path, track)), order[0])


def _is_audible(path: Path, track: int) -> bool:
    """Whether a sample of the track's beginning is `AUDIBLE`; damage is silence."""
    with open_media(path) as container:
        stream = container.streams.audio[track]
        mixer, heard = AudioResampler("fltp"), 0.0
        try:
            for frame in () if stream.codec_context is None else container.decode(stream):
                if not isinstance(frame, AudioFrame) or not frame.samples:
                    continue
                for part in mixer.resample(frame):
                    if np.abs(part.to_ndarray()).max(initial=0) >= AUDIBLE:
                        return True
                heard += frame.samples / frame.sample_rate
                if heard > _LISTEN:
                    return False
        except (av.error.FFmpegError, OSError, ValueError):
            return False
    return False


MAX_GAP = 0.05
"""Seconds by which timestamps may wander before silence is put in or samples are taken out."""

_DECLARED_LENGTH = ("w64", "flac", "mov", "caf", "aiff")
"""Containers whose header counts the samples, so that a truncated file can be recognised."""

_WITHOUT_GAPS = ("flac", "ogg")
"""Containers in which a gap of the timestamps means that a part was lost."""

_MAX_CHANNELS = 2
_KNOWN_LAYOUT = {1: "mono", 2: "stereo", 3: "3.0", 4: "quad", 5: "5.0", 6: "5.1", 8: "7.1"}


class Recording:
    """An open recording whose samples come as a stream; see `open_recording`.

    Attributes:
        path: the file.
        rate: samples a second, as the decoder delivers them.
        channels: 1 or 2; more channels are mixed down to stereo.
        start: presentation time of the first sample in seconds.
    """

    def __init__(self, path: Path, container: InputContainer, stream: AudioStream) -> None:
        self.path = path
        self._container = container
        self._stream = stream
        if stream.codec_context.name == "flac":
            stream.codec_context.options = {"err_detect": "crccheck+explode"}
        self._frames = self._decode()
        first = next(self._frames, None)
        if first is None:
            raise BadInput(f"{path}: holds no sound samples; give another recording")
        self._first = first
        self.rate = int(first.sample_rate)
        self.channels = min(len(first.layout.channels), _MAX_CHANNELS)
        self.start = first.time or 0.0
        layout = "mono" if self.channels == 1 else "stereo"
        # libswresample scales a mix so that it cannot clip only when the result is integer.
        mixed = len(first.layout.channels) > _MAX_CHANNELS
        self._mixer = AudioResampler("s32p" if mixed else "fltp", layout, self.rate)

    def _decode(self) -> Iterator[AudioFrame]:
        try:
            for frame in self._container.decode(self._stream):
                if isinstance(frame, AudioFrame) and frame.samples:
                    yield frame
        except (av.error.FFmpegError, OSError, ValueError) as error:
            raise BadInput(
                f"{self.path}: the sound is damaged ({describe(error)}); "
                "export or convert the recording again"
            ) from error

    def _mix(self, frame: AudioFrame | None) -> Iterator[np.ndarray]:
        try:
            mixed = self._mixer.resample(None if frame is None else _with_layout(frame))
        except (av.error.FFmpegError, ValueError) as error:
            raise BadInput(
                f"{self.path}: rate or channels change midway ({describe(error)}); "
                "convert the recording to one format first"
            ) from error
        for part in mixed:
            samples = part.to_ndarray()
            if samples.dtype == np.int32:
                samples = samples.astype(np.float32) / np.float32(2**31)
            yield samples

    def blocks(self) -> Iterator[np.ndarray]:
        """Decode from the first sample to the last; can be called once.

        Timestamps are followed: where they jump by more than `MAX_GAP`, silence is put in or
        samples are left out, so that sample i is at `start + i / rate` to that precision.

        Yields:
            samples `(channels, n)` float32, full scale 1.

        Raises:
            BadInput: the sound is damaged, or ends before the length its header declares.
        """
        position = 0
        frame: AudioFrame | None = self._first
        while frame is not None:
            slack = self._slack(frame, position)
            for first in range(0, slack, self.rate):
                yield np.zeros((self.channels, min(self.rate, slack - first)), np.float32)
            position += max(slack, 0)
            skip = max(-slack, 0)
            for samples in self._mix(frame):
                kept = samples[:, skip:]
                skip -= samples.shape[1] - kept.shape[1]
                position += kept.shape[1]
                if kept.shape[1]:
                    yield kept
            frame = next(self._frames, None)
        for samples in self._mix(None):
            position += samples.shape[1]
            yield samples
        self._check_length(position)

    def _slack(self, frame: AudioFrame, position: int) -> int:
        """Samples of silence to put before the frame, or minus those to leave out of it."""
        if frame.time is None:
            return 0
        check_jump(self.path, self.start + position / self.rate, frame.time)
        slack = round((frame.time - self.start) * self.rate) - position
        name = self._container.format.name
        if slack > (1 if name == "flac" else MAX_GAP * self.rate) and name in _WITHOUT_GAPS:
            raise BadInput(
                f"{self.path}: the sound is damaged (a gap at {frame.time:.2f} s); "
                "export or convert the recording again"
            )
        return slack if abs(slack) > MAX_GAP * self.rate else 0

    def _check_length(self, samples: int) -> None:
        """Refuse a recording of which less than declared was decoded."""
        name, stream = self._container.format.name, self._stream
        if name == "wav" and _is_cut_wav(self.path):
            raise BadInput(f"{self.path}: is cut off; copy or export it again")
        # An mp3's length is known when its encoder noted it, and with it the delay.
        known = name.split(",")[0] in _DECLARED_LENGTH or (name == "mp3" and stream.start_time)
        if not known or stream.duration is None or stream.time_base is None:
            return
        seconds, declared = samples / self.rate, float(stream.duration * stream.time_base)
        tolerance = 1 / self.rate if name == "flac" else max(0.25, 0.01 * declared)
        if seconds < declared - tolerance:
            raise BadInput(
                f"{self.path}: is cut off ({seconds:.1f} s of {declared:.1f} s can be decoded); "
                "copy or export it again"
            )


def _is_cut_wav(path: Path) -> bool:
    """Whether the file ends before its RIFF data chunk does (0 and 2^32-1 mean unknown)."""
    with path.open("rb") as file:
        end = file.seek(0, 2)
        place = 12
        while place + 8 <= end:
            file.seek(place)
            chunk = file.read(8)
            size = int.from_bytes(chunk[4:], "little")
            if chunk[:4] == b"data":
                return size not in (0, 2**32 - 1) and place + 8 + size > end
            place += 8 + size + size % 2
    return False


def _with_layout(frame: AudioFrame) -> AudioFrame:
    """The frame with named channels; a file may only count them."""
    channels = len(frame.layout.channels)
    if not frame.layout.name.endswith("channels") or channels not in _KNOWN_LAYOUT:
        return frame
    named = AudioFrame.from_ndarray(frame.to_ndarray(), frame.format.name, _KNOWN_LAYOUT[channels])
    named.sample_rate = frame.sample_rate
    named.pts = frame.pts
    if frame.time_base is not None:
        named.time_base = frame.time_base
    return named


@contextmanager
def open_recording(path: Path) -> Iterator[Recording]:
    """Open the sound of a recording or video; `sound_track` chooses among several tracks.

    Raises:
        BadInput: missing, a folder, 0 bytes, not media, without sound, or damaged.
    """
    path = Path(path)
    with open_media(path) as container:
        if not container.streams.audio:
            raise BadInput(f"{path}: has no sound; give a recording with speech")
        stream = container.streams.audio[sound_track(path)]
        if stream.codec_context is None:
            raise BadInput(f"{path}: its sound is in a format that cannot be decoded; convert it")
        yield Recording(path, container, stream)


def read_sound(path: Path, rate: int = SAMPLE_RATE, origin: float | None = None) -> np.ndarray:
    """Read a recording, or a video's sound, as mono samples.

    The delay that codecs put before the first sample is left out. Channels are averaged; the
    resampling is band-limited with linear phase, so nothing is shifted.

    Args:
        path: any container and codec that FFmpeg decodes.
        rate: samples a second of the result.
        origin: presentation time in seconds that sample 0 shall have (a video's start, for
            sound in step with its pictures); None for the sound's own first sample.

    Returns:
        samples `(N,)` float32 in [-1, 1].

    Raises:
        BadInput: missing, a folder, 0 bytes, not media, no sound, damaged or cut off.
    """
    with open_recording(path) as recording:
        converter = soxr.ResampleStream(recording.rate, rate, 1, dtype="float32")
        lead = 0 if origin is None else round((recording.start - origin) * recording.rate)
        grown = array("f")  # in place: an hour of sound is large enough not to be held twice

        def put(mono: np.ndarray, last: bool = False) -> None:
            block = np.nan_to_num(converter.resample_chunk(mono, last=last))
            grown.frombytes(np.clip(block, -1.0, 1.0).tobytes())

        put(np.zeros(max(lead, 0), np.float32))
        count, skip = max(lead, 0), max(-lead, 0)
        for block in recording.blocks():
            mono = block.mean(axis=0)[skip:]
            skip -= block.shape[1] - len(mono)
            count += len(mono)
            put(mono)
        length = round(count * rate / recording.rate)
        put(np.zeros(0, np.float32), last=True)
    samples = np.frombuffer(grown, np.float32)[:length]
    if not len(samples):
        raise BadInput(f"{path}: holds no sound samples; give another recording")
    return np.pad(samples, (0, length - len(samples))) if len(samples) < length else samples


def write_wav(path: Path, samples: np.ndarray, rate: int = SAMPLE_RATE) -> None:
    """Write samples as a 16-bit PCM wav file.

    Args:
        path: the file to write.
        samples: `(N,)` mono or `(N, channels)` float in [-1, 1]; more is clipped.
        rate: samples a second.
    """
    clipped = np.clip(np.asarray(samples, np.float32), -1.0, 1.0)
    soundfile.write(str(path), clipped, rate, subtype="PCM_16", format="WAV")
