"""People in a video: faces seen now and then become persons who are there or not."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from data_prep.speaker.faces import Detector, Face, find_faces, median_face, newcomers, rivals

NEAR_STEP = 10
"""Frames after which known faces are looked for where they were."""

WHOLE_STEP = 100
"""Frames after which the whole picture is searched."""

_SOON, _LATEST = 25, 200
"""Frames after which the search is repeated when nobody is found: at first, and at most."""

_SIDES = (480, 720)
"""Long sides in pixels at which the whole picture is searched."""

_FOLLOWED = 3
"""Faces that are followed at a time."""

_PATIENCE = 3
"""Times that a face may be missed, behind a hand, before it is given up."""

GAP = 75
"""Frames for which a person may be unseen without being away."""

_FEWEST, _SHARE = 3, 0.3
"""Sightings that make a person, and the part of the looks in which there must be one."""

_JUMP = 0.75
"""Way of a face, in its heights, between two looks, that no speaker makes."""


@dataclass(frozen=True)
class Sighting:
    """The faces that were found in a frame.

    Attributes:
        frame: its number.
        faces: those found, largest first.
    """

    frame: int
    faces: tuple[Face, ...]


class FaceFollower:
    """Looks for faces as the pictures go by: seldom everywhere, often where there were some.

    Args:
        detector: of faces, asked before the cascades.

    Attributes:
        sightings: what was found, of every picture that was looked at.
        places: where faces are, or were when they were last found in this scene.
    """

    def __init__(self, detector: Detector | None = None) -> None:
        self._detector = detector
        self.sightings: list[Sighting] = []
        self.places: list[Face] = []
        self._known: list[tuple[Face, int]] = []
        self._next_near = self._next_whole = 0
        self._wait = _SOON
        self._fresh = True

    @property
    def astray(self) -> bool:
        """Whether there was somebody in this scene who is not found any more."""
        return bool(self.places) and not self._known

    def add(self, grey: np.ndarray, frame: int, new: bool) -> None:
        """Look at a picture if it is time.

        Args:
            grey: `(H, W)` uint8.
            frame: its number.
            new: whether it shows another scene than the last.
        """
        if new:
            self.places, self._known = [], []
            self._wait, self._next_whole, self._fresh = _SOON, frame, True
        if frame >= self._next_whole:
            faces = [face for face, _ in self._known]
            if faces and not newcomers(grey, faces, _SIDES[0], self._detector):
                self._look_again(grey, frame)
                self._next_whole = frame + (WHOLE_STEP if self._known else NEAR_STEP)
            else:
                self._look_everywhere(grey, frame)
        elif frame >= self._next_near and self._known:
            self._look_again(grey, frame)
            if not self._known:
                self._next_whole = min(self._next_whole, frame + NEAR_STEP)
        self.places = [face for face, _ in self._known] or self.places

    def _look_everywhere(self, grey: np.ndarray, frame: int) -> None:
        found = find_faces(grey, sides=_SIDES, detector=self._detector)
        self.sightings.append(Sighting(frame, tuple(found)))
        if found:
            self._known = [(face, _PATIENCE) for face in rivals(found)[:_FOLLOWED]]
            # A hand may hide a face in the first picture, so it is looked at soon again.
            self._next_whole = frame + (_SOON if self._fresh else WHOLE_STEP)
            self._wait, self._fresh = _SOON, False
        else:
            self._known = []
            self._next_whole = frame + self._wait
            self._wait = min(2 * self._wait, _LATEST)
        self._next_near = frame + NEAR_STEP

    def _look_again(self, grey: np.ndarray, frame: int) -> None:
        found: list[Face] = []
        known = []
        for face, patience in self._known:
            near = find_faces(grey, face, detector=self._detector)
            best = min(near, key=lambda other: _apart(face, other), default=None)
            if best is not None:
                found.append(best)
                known.append((best, _PATIENCE))
            elif patience > 1:
                known.append((face, patience - 1))
        self._known = known
        self.sightings.append(Sighting(frame, tuple(sorted(found, key=lambda face: -face.h))))
        self._next_near = frame + NEAR_STEP


@dataclass
class Track:
    """One person's face over time.

    Attributes:
        seen: frames and faces in order of time.
    """

    seen: list[tuple[int, Face]] = field(default_factory=list)

    @property
    def first(self) -> int:
        """Frame of the first sighting."""
        return self.seen[0][0]

    @property
    def last(self) -> int:
        """Frame of the last sighting."""
        return self.seen[-1][0]

    @property
    def face(self) -> Face:
        """The median face."""
        return median_face([face for _, face in self.seen])


def _apart(a: Face, b: Face) -> float:
    """Distance of two faces' centres in heights of the larger."""
    return float(np.hypot(a.centre_x - b.centre_x, a.centre_y - b.centre_y)) / max(a.h, b.h)


def _follows(earlier: Face, later: Face) -> bool:
    return _apart(earlier, later) < 1.0 and 0.6 < later.h / earlier.h < 1 / 0.6


def link(sightings: Sequence[Sighting]) -> list[Track]:
    """Persons: faces that stay where they are, or move less than a face between two looks.

    What is seen less than three times (if it is looked at so often), or in less than a third of
    the looks at it, is none.

    Args:
        sightings: of one shot, in order of time.
    """
    tracks: list[Track] = []
    for sighting in sightings:
        open_tracks = [t for t in tracks if sighting.frame - t.last <= 2 * GAP]
        for face in sighting.faces:
            fitting = [t for t in open_tracks if _follows(t.seen[-1][1], face)]
            if fitting:
                nearest = min(fitting, key=lambda t: _apart(t.seen[-1][1], face))
                open_tracks.remove(nearest)
            else:
                nearest = Track()
                tracks.append(nearest)
            nearest.seen.append((sighting.frame, face))
    fewest = min(_FEWEST, len(sightings))  # a short shot is looked at once
    looks = np.array([sighting.frame for sighting in sightings])

    def is_person(track: Track) -> bool:
        chances = ((looks >= track.first) & (looks <= track.last)).sum()
        return len(track.seen) >= fewest and len(track.seen) >= _SHARE * chances

    return [track for track in tracks if is_person(track)]


def presence(tracks: Sequence[Track], first: int, stop: int) -> np.ndarray:
    """Who is in the picture when, `(tracks, stop - first)` bool.

    A person stays present through gaps of `GAP` frames, and to the shot's ends when seen that
    close to them. Whom `rivals` leaves out beside a larger face is not present then.
    """
    there = np.zeros((len(tracks), stop - first), bool)
    for row, track in zip(there, tracks, strict=True):
        frames = [frame for frame, _ in track.seen]
        if frames[0] - first <= GAP:
            frames.insert(0, first)
        if stop - frames[-1] <= GAP + NEAR_STEP:
            frames.append(stop - 1)
        for a, b in zip(frames, frames[1:], strict=False):
            if b - a <= GAP or (a, b) in ((first, frames[1]), (frames[-2], stop - 1)):
                row[a - first : b - first + 1] = True
        row[np.array(frames) - first] = True
    faces = [track.face for track in tracks]
    for pattern in np.unique(there, axis=1).T:
        if pattern.sum() < 2:
            continue
        together = sorted(np.flatnonzero(pattern), key=lambda i: -faces[i].h)
        real = rivals([faces[i] for i in together])
        when = (there == pattern[:, None]).all(axis=0)
        for i in together:
            if faces[i] not in real:
                there[i, when] = False
    return there


def jumps(faces: Sequence[tuple[int, Face]]) -> bool:
    """Whether a face jumps between two looks in succession; one false hit is no jump.

    Args:
        faces: frames and faces of one person in order of time.
    """
    triples = zip(faces, faces[1:], faces[2:], strict=False)
    smooth = [(b[0], median_face([a[1], b[1], c[1]])) for a, b, c in triples]
    return any(
        later - earlier <= 2 * NEAR_STEP and _apart(before, after) > _JUMP
        for (earlier, before), (later, after) in zip(smooth, smooth[1:], strict=False)
    )
