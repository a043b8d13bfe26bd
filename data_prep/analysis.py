"""The first of two passes over a video: shots, camera, faces and bars, from small pictures."""

from dataclasses import dataclass
from pathlib import Path

from data_prep.bars import BarDetector, View
from data_prep.camera import CameraPath, CameraTracker
from data_prep.shots import Shot, ShotDetector
from data_prep.tracking import FaceFollower, Sighting
from data_prep.video import VideoInfo, read_grey

LONGEST = 720
"""Long side in pixels of the pictures that are looked at."""


@dataclass(frozen=True)
class Analysis:
    """What was seen of a video; frames are counted at 25 fps from its first frame.

    Attributes:
        frames: of the whole video.
        shots: all frames as shots, and fades between them.
        camera: its motion, in pixels of the original picture.
        sightings: faces in pixels of the original picture.
        bars: tells where the picture has black bars.
    """

    frames: int
    shots: list[Shot]
    camera: CameraPath
    sightings: list[Sighting]
    bars: BarDetector

    def view(self, shot: Shot, info: VideoInfo) -> View:
        """The picture between black bars in a shot."""
        return self.bars.view(shot.first, shot.stop, info.width, info.height)


def analyse(path: Path, info: VideoInfo, faces: bool = True) -> Analysis:
    """Go through a video once.

    Args:
        path: the video.
        info: what `probe` tells of it.
        faces: whether to look for faces.

    Raises:
        BadInput: as `read_grey`.
    """
    shots, camera, follower, bars = ShotDetector(), CameraTracker(), FaceFollower(), BarDetector()
    count = 0
    scale = 1.0
    for grey, frames in read_grey(path, LONGEST):
        scale = max(info.height, info.width) / max(grey.shape)
        shots.add(grey, frames)
        if follower.astray:
            camera.hold(frames)
        else:
            camera.add(grey, follower.places, frames)
        people = len(follower.places)
        if faces:
            follower.add(grey, count, new=camera.lost)
        if camera.lost or len(follower.places) > people:
            camera.avoid(follower.places)
        bars.add(grey, frames, cut=camera.lost)
        count += frames
    sightings = [
        Sighting(s.frame, tuple(face.scaled(scale) for face in s.faces)) for s in follower.sightings
    ]
    return Analysis(count, shots.shots(), camera.path(scale), sightings, bars)
