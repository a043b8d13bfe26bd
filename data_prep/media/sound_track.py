"""Which of a file's sound tracks is heard."""

from pathlib import Path

import av.error
import numpy as np
from av.audio.frame import AudioFrame
from av.audio.resampler import AudioResampler
from av.stream import Disposition

from data_prep.media.container import Damage, decode, open_media

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
        if stream.codec_context is None:
            return False
        mixer, heard = AudioResampler("fltp"), 0.0
        for frame in decode(container, stream, Damage()):
            if not isinstance(frame, AudioFrame) or not frame.samples:
                continue
            try:
                parts = mixer.resample(frame)
            except (av.error.FFmpegError, ValueError):  # rate or channels change midway
                return True
            if any(np.abs(part.to_ndarray()).max(initial=0) >= AUDIBLE for part in parts):
                return True
            heard += frame.samples / frame.sample_rate
            if heard > _LISTEN:
                return False
    return False
