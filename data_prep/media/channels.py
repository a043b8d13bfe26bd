"""Channels of decoded sound, mixed to one or two."""

from collections.abc import Callable, Iterator
from pathlib import Path

import av.error
import numpy as np
from av.audio.frame import AudioFrame
from av.audio.resampler import AudioResampler

from data_prep.errors import BadInput
from data_prep.media.container import describe

_MAX_CHANNELS = 2
_KNOWN_LAYOUT = {1: "mono", 2: "stereo", 3: "3.0", 4: "quad", 5: "5.0", 6: "5.1", 8: "7.1"}
_LOUDEST = 64.0
"""Full scales above which a sample of floating point is nonsense."""


class Mixer:
    """Turns decoded frames into float samples of one or two channels at one rate."""

    def __init__(
        self, first: AudioFrame, rate: int, path: Path, channel: int | None = None
    ) -> None:
        self._rate, self._path, self._channel = rate, path, channel
        self.channels = min(len(first.layout.channels), _MAX_CHANNELS)
        self.odd = 0
        self._kind: tuple[str, str, int] | None = None
        self._convert: Callable[[AudioFrame | None], list[AudioFrame]] = lambda frame: []
        self.plain = False
        if not self._can_mix(first):  # nobody says from where the channels sound
            self.channels, self.plain = 1, True
        self.energy, self.of_mean = np.zeros(len(first.layout.channels)), 0.0

    def _can_mix(self, frame: AudioFrame) -> bool:
        try:
            self._resampler(frame).resample(_with_layout(frame))
        except (av.error.FFmpegError, ValueError):
            return False
        return True

    def _resampler(self, frame: AudioFrame) -> AudioResampler:
        if self.plain:  # packed: PyAV reads past the eighth of separate planes
            return AudioResampler("flt", None, self._rate)
        layout = "mono" if self.channels == 1 else "stereo"
        # libswresample scales a mix so that it cannot clip only when the result is integer.
        mixed = len(frame.layout.channels) > self.channels
        return AudioResampler("s32p" if mixed else "fltp", layout, self._rate)

    def __call__(self, frame: AudioFrame | None) -> Iterator[np.ndarray]:
        """Samples `(channels, n)` of a frame; of None those that are still held."""
        if frame is not None:
            kind = (frame.format.name, frame.layout.name, frame.sample_rate)
            if kind != self._kind:
                if self._kind is not None:
                    yield from self._finished(None)
                self._kind, self._convert = kind, self._resampler(frame).resample
        yield from self._finished(frame)

    def _one(self, samples: np.ndarray) -> np.ndarray:
        """One channel `(1, n)` of many; their energies are added up on the way."""
        mean = samples.mean(axis=0)
        if len(samples) == len(self.energy):
            self.energy += np.square(samples, dtype=np.float64).sum(axis=1)
            self.of_mean += float(np.square(mean, dtype=np.float64).sum())
        if self._channel is None or self._channel >= len(samples):
            return mean[None]
        return np.ascontiguousarray(samples[self._channel : self._channel + 1])

    def _finished(self, frame: AudioFrame | None) -> Iterator[np.ndarray]:
        if self._kind is None:
            return
        try:
            given = frame if frame is None or self.plain else _with_layout(frame)
            parts = self._convert(given)
        except (av.error.FFmpegError, ValueError) as error:
            raise BadInput(
                f"{self._path}: its channels cannot be mixed ({describe(error)}); "
                "export it with one or two"
            ) from error
        for part in parts:
            samples = part.to_ndarray()
            if samples.dtype == np.int32:
                samples = samples.astype(np.float32) / np.float32(2**31)
            finite = np.isfinite(samples)
            if not finite.all():
                self.odd += int((~finite).sum())
                samples = np.where(finite, samples, np.float32(0))
            if self.plain:
                samples = self._one(samples.reshape(-1, len(part.layout.channels)).T)
            yield np.clip(samples, -_LOUDEST, _LOUDEST)


CANCELLED = 0.1
"""Energy of the mean of channels, in that of the loudest, below which they cancel out."""


def cancelled(energy: np.ndarray, of_mean: float) -> int | None:
    """The loudest channel if the channels cancel out in their mean, else None.

    Args:
        energy: `(channels,)` sums of squares.
        of_mean: that of their mean.
    """
    return int(energy.argmax()) if of_mean < CANCELLED * energy.max() else None


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
