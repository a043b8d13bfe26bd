"""The square of a video that shows its speaker: one for the whole video, however long."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data_prep.errors import BadInput
from data_prep.media.video import VideoInfo, read_frames
from data_prep.prepare.analysis import Analysis, View, analyse
from data_prep.prepare.shots import Shot
from data_prep.rates import FPS, IMAGE_SIZE
from data_prep.speaker.crop import Crop, check_crop, choose_person, cut_out, speaker_crop
from data_prep.speaker.faces import Detector, Face, median_face
from data_prep.speaker.tracking import Sighting, link, presence

_PRESENT = 0.2
"""Part of a shot for which somebody must be there to be chosen."""


@dataclass(frozen=True)
class Square:
    """Where a video shows its speaker.

    Attributes:
        path: the video.
        view: its picture between black bars.
        crop: the square, in pixels of the whole picture.
        frames: of the video at 25 fps; expected, where `cuts` is unknown.
        cuts: changes of the shot; None where they were not searched for.
    """

    path: Path
    view: View
    crop: Crop
    frames: int
    cuts: int | None = None

    def pictures(self) -> Iterator[np.ndarray]:
        """Every frame of the square, 25 a second by presentation time: (256, 256, 3) uint8 RGB.

        Raises:
            BadInput: as `read_frames`.
        """
        crop = Crop(self.crop.x - self.view.left, self.crop.y - self.view.top, self.crop.size)
        for frame in read_frames(self.path, FPS):
            yield cut_out(self.view.of(frame), crop, IMAGE_SIZE)


def given_square(path: Path, info: VideoInfo, crop: Crop, option: str) -> Square:
    """The square that a person names by an option of the command.

    Raises:
        BadInput: it lies outside of the picture.
    """
    check_crop(crop, info.height, info.width, option)
    view = View(0, 0, info.width, info.height)
    return Square(path, view, crop, round(info.duration * FPS))


def find_square(
    path: Path, info: VideoInfo, person: str | None, option: str, detector: Detector | None = None
) -> Square:
    """The square around the speaker of a video, by the rule of the training data.

    The longest shot decides; the median of the speaker's face there gives the square.

    Args:
        path: the video; it is decoded once, small.
        info: as `probe` returns it.
        person: "left", "right" or "largest" of several people; None refuses them.
        option: of the command that names a square, for messages.
        detector: of faces, asked before the cascades.

    Raises:
        BadInput: nobody is seen, or several people and none is chosen.
    """
    analysis = analyse(path, info, detector=detector)
    shots = [shot for shot in analysis.shots if not shot.faded] or analysis.shots
    shot = max(shots, key=lambda s: s.stop - s.first)
    view = analysis.view(shot, info)
    face = _speaker(path, analysis, shot, view, person, option)
    inside = face.scaled(1.0, -view.left, -view.top)
    crop = speaker_crop(inside, view.height, view.width)
    crop = Crop(crop.x + view.left, crop.y + view.top, crop.size)
    return Square(path, view, crop, analysis.frames, len(shots) - 1)


def _speaker(
    path: Path, analysis: Analysis, shot: Shot, view: View, person: str | None, option: str
) -> Face:
    """The speaker's median face in a shot."""
    seen = [
        Sighting(s.frame, tuple(face for face in s.faces if _between(view, face)))
        for s in analysis.sightings
        if shot.first <= s.frame < shot.stop
    ]
    tracks = link(seen)
    people = [track.face for track in tracks]
    together = 0
    if tracks:
        there = presence(tracks, shot.first, shot.stop)
        together = int(there.sum(axis=0).max())
        share = there.mean(axis=1)
        usual = share >= min(_PRESENT, share.max())
        people = [face for face, often in zip(people, usual, strict=True) if often]
        if person is None and together < 2:
            return tracks[int(share.argmax())].face
    elif any(s.faces for s in seen):  # too short a shot for anybody to be seen three times
        together = max(len(s.faces) for s in seen)
        people = list(max(seen, key=lambda s: len(s.faces)).faces)
        if person is None and together < 2:
            return median_face([face for s in seen for face in s.faces])
    if not people:
        raise BadInput(f"{path}: no face found; give the square yourself with {option} x,y,size")
    if person is None:
        raise BadInput(
            f"{path}: shows {together} people; choose with {option.replace('crop', 'person')} "
            f"left, right or largest, or give the square yourself with {option} x,y,size"
        )
    return people[choose_person(people, person)]


def _between(view: View, face: Face) -> bool:
    across = view.left <= face.centre_x < view.right
    return across and view.top <= face.centre_y < view.bottom
