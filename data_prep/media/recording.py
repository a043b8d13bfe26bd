"""One of a file's sound tracks as a stream of samples at its own rate."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from av.audio.frame import AudioFrame

from data_prep.errors import BadInput, note
from data_prep.media.channels import Mixer, cancelled
from data_prep.media.container import TOLERANCE, Damage, check_jump, decode, open_media
from data_prep.media.lengths import chained_spans, wav_claim
from data_prep.media.sound_track import sound_track

MAX_GAP = 0.05
"""Seconds by which timestamps may wander before silence is put in or samples are taken out."""

_MOST_SILENCE = 3600.0
"""Seconds of silence that gaps of the timestamps may add up to."""

_DECLARED_LENGTH = ("w64", "flac", "mov", "caf", "aiff")
"""Containers whose header counts the samples, so that a truncated file can be recognised."""

_UNTIMED = ("mp3", "aac", "ac3", "eac3", "dts", "amr", "loas")
"""Containers without timestamps: what cannot be decoded of them leaves no gap."""

_RATES = (50, 4_000_000)
"""Samples a second below and above which a header is nonsense."""


class Recording:
    """An open recording whose samples come as a stream; see `open_recording`.

    Attributes:
        path: the file.
        rate: samples a second, as the decoder delivers them.
        channels: 1 or 2; more channels are mixed down to stereo, or to mono where it is not
            known from where each sounds.
        start: presentation time of the first sample in seconds.
    """

    def __init__(self, path: Path, track: int, channel: int | None = None) -> None:
        """Decode the first frame.

        Args:
            path: the file.
            track: number of the sound track.
            channel: that is heard where it is not known from where each sounds; None for the mean.
        """
        self.path = path
        self._track = track
        self._damage = Damage()
        self._moving = False
        self._declared: float | None = None
        self._untimed = self._exact = False
        self._frames = self._decode()
        first = next(self._frames, None)
        if first is None:
            self._damage.check(path, "sound")
            raise BadInput(f"{path}: holds no sound samples; give another recording")
        self._first = first
        self.rate = int(first.sample_rate)
        if not _RATES[0] <= self.rate <= _RATES[1]:
            raise BadInput(f"{path}: claims {self.rate} samples a second; export it again")
        self.start = first.time or 0.0
        self._mix = Mixer(first, self.rate, path, channel)
        self.channels = self._mix.channels
        self._position = 0
        self._silence = 0
        self._zero: float | None = self.start

    def _decode(self) -> Iterator[AudioFrame]:
        """Frames of every part of the file; `_zero` is forgotten where one begins."""
        for number, span in enumerate(chained_spans(self.path)):
            with open_media(self.path, span) as container:
                tracks = container.streams.audio
                stream = tracks[min(self._track, len(tracks) - 1)] if tracks else None
                if stream is None or stream.codec_context is None:
                    continue
                name = container.format.name.split(",")[0]
                if name == "flac":
                    stream.codec_context.options = {"err_detect": "crccheck+explode"}
                self._zero = None
                self._untimed, self._exact = name in _UNTIMED, name == "flac"
                self._moving = any(video.average_rate for video in container.streams.video)
                # An mp3's length is known when its encoder noted it, and with it the delay.
                known = name in _DECLARED_LENGTH or (name == "mp3" and stream.start_time)
                if known and stream.duration is not None and stream.time_base is not None:
                    self._declared = float(stream.duration * stream.time_base)
                if number:
                    self._declared = None
                for frame in decode(container, stream, self._damage):
                    if isinstance(frame, AudioFrame) and frame.samples:
                        yield frame

    @property
    def plain(self) -> bool:
        """Whether it is not known from where each of its channels sounds."""
        return self._mix.plain

    def loudest(self) -> int | None:
        """Channel to be heard in place of a mean in which they cancel out; decodes everything.

        None where the mean is heard, or all channels are.
        """
        if not self.plain:
            return None
        for _ in self.blocks():
            pass
        return cancelled(self._mix.energy, self._mix.of_mean)

    def close(self) -> None:
        """Let go of the file."""
        self._frames.close()  # type: ignore[attr-defined]

    def blocks(self) -> Iterator[np.ndarray]:
        """Decode from the first sample to the last; can be called once.

        Timestamps are followed: where they jump by more than `MAX_GAP`, silence is put in or
        samples are left out, so that sample i is at `start + i / rate` to that precision. What
        was odd is noted.

        Yields:
            samples `(channels, n)` float32, full scale 1, finite.

        Raises:
            BadInput: most of the sound is damaged, or its timestamps jump.
        """
        frame: AudioFrame | None = self._first
        while frame is not None:
            slack = self._slack(frame)
            for first in range(0, slack, self.rate):
                yield np.zeros((self.channels, min(self.rate, slack - first)), np.float32)
            self._position += max(slack, 0)
            skip = max(-slack, 0)
            for samples in self._mix(frame):
                kept = samples[:, skip:]
                skip -= samples.shape[1] - kept.shape[1]
                self._position += kept.shape[1]
                if kept.shape[1]:
                    yield kept
            frame = next(self._frames, None)
        for samples in self._mix(None):
            self._position += samples.shape[1]
            yield samples
        self._tell(self._position / self.rate)

    def _slack(self, frame: AudioFrame) -> int:
        """Samples of silence to put before the frame, or minus those to leave out of it."""
        if frame.time is None or self._untimed:
            return 0
        now = self._position / self.rate
        if self._zero is None:  # another part of the file, with times of its own
            self._zero = frame.time - now
        expected = self._zero + now
        if self._moving:
            check_jump(self.path, expected, frame.time)
        elif not -1.0 <= frame.time - expected <= _MOST_SILENCE:
            note(f"{self.path}: its timestamps jump at {now:.1f} s; the parts are joined there")
            self._zero = frame.time - now
            return 0
        slack = round((frame.time - expected) * self.rate)
        if abs(slack) <= (1 if self._exact else MAX_GAP * self.rate):
            return 0
        self._silence += max(slack, 0)
        if self._silence > _MOST_SILENCE * self.rate:
            raise BadInput(f"{self.path}: its timestamps jump again and again; export it again")
        return slack

    def _tell(self, seconds: float) -> None:
        """Note what was odd about the sound, now that all of it has been decoded."""
        self._damage.check(self.path, "sound")
        declared = self._declared
        if declared is None:
            declared = seconds * wav_claim(self.path)
        if declared - seconds > TOLERANCE:
            note(
                f"{self.path}: ends after {seconds:.1f} s, though its header says "
                f"{declared:.1f} s; what is there is used"
            )
        silence = self._silence / self.rate
        if silence > TOLERANCE:
            note(f"{self.path}: {silence:.1f} s of the sound are missing or damaged, and silent")
        if self._mix.odd:
            note(f"{self.path}: {self._mix.odd} of its samples are no numbers; taken for silence")


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
    track = sound_track(path)
    with open_media(path) as container:
        if container.streams.audio[track].codec_context is None:
            raise BadInput(f"{path}: its sound is in a format that cannot be decoded; convert it")
    recording = Recording(path, track)
    loudest = recording.loudest()
    if recording.plain:
        recording.close()
        recording = Recording(path, track, loudest)
    try:
        yield recording
    finally:
        recording.close()
