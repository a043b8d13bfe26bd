"""Several sound tracks: the default one, unless it is silent."""

from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from av.stream import Disposition

from data_prep.media.audio import read_sound, sound_track
from data_prep.media.video import probe

RATE = 16_000


def write_tracks(path: Path, levels: list[float], default: int) -> None:
    """A video of a second with sound tracks of constant levels, as raw samples."""
    with av.open(str(path), "w") as container:
        video = container.add_stream("libx264", rate=25)
        video.width = video.height = 64
        tracks = [container.add_stream("pcm_s16le", rate=RATE, layout="mono") for _ in levels]
        for i, track in enumerate(tracks):
            track.disposition = Disposition.default.value if i == default else 0
        for k in range(25):
            frame = av.VideoFrame.from_ndarray(np.full((64, 64, 3), 99, np.uint8), "rgb24")
            frame.pts, frame.time_base = k, Fraction(1, 25)
            container.mux(video.encode(frame))
        container.mux(video.encode(None))
        for track, level in zip(tracks, levels, strict=True):
            samples = np.full((1, RATE), round(level * 32767), np.int16)
            sound = av.AudioFrame.from_ndarray(samples, "s16", "mono")
            sound.sample_rate, sound.pts, sound.time_base = RATE, 0, Fraction(1, RATE)
            container.mux(track.encode(sound))
            container.mux(track.encode(None))


@pytest.mark.parametrize(
    ("levels", "default", "taken"),
    [([0.1], 0, 0), ([0.1, 0.2], 1, 1), ([0.1, 0.2, 0.0], 2, 0), ([0.0, 0.0], 1, 1)],
)
def test_the_default_track_with_sound_is_taken(
    tmp_path: Path, levels: list[float], default: int, taken: int
) -> None:
    path = tmp_path / "a.mkv"
    write_tracks(path, levels, default)
    assert sound_track(path) == taken
    info = probe(path)
    assert (info.sound_tracks, info.sound_track) == (len(levels), taken)
    assert np.median(read_sound(path)) == pytest.approx(levels[taken], abs=1e-3)
