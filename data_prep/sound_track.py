"""Which of a file's sound tracks is taken."""

from pathlib import Path

import av.error
import numpy as np
from av.audio.frame import AudioFrame
from av.audio.resampler import AudioResampler
from av.audio.stream import AudioStream
from av.container import InputContainer
from av.stream import Disposition

from data_prep.container import open_media

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
    with open_media(path) as container:
        stream = container.streams.audio[track]
        return stream.codec_context is not None and _reaches(container, stream, AUDIBLE)


def _reaches(container: InputContainer, stream: AudioStream, level: float) -> bool:
    """Whether a sample of the track's beginning is at least that loud; damage is silence."""
    mixer = AudioResampler("fltp")
    heard = 0.0
    try:
        for frame in container.decode(stream):
            if not isinstance(frame, AudioFrame) or not frame.samples:
                continue
            for part in mixer.resample(frame):
                if np.abs(part.to_ndarray()).max(initial=0) >= level:
                    return True
            heard += frame.samples / frame.sample_rate
            if heard > _LISTEN:
                return False
    except (av.error.FFmpegError, OSError, ValueError):
        return False
    return False
