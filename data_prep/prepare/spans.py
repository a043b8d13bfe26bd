"""Which parts of a video show one clear speaker to a still camera, and the square around them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from data_prep.media.video import VideoInfo
from data_prep.prepare.analysis import Analysis, View
from data_prep.prepare.camera import FURTHEST
from data_prep.prepare.shots import Shot
from data_prep.prepare.source import IngestionConfig, Span
from data_prep.speaker.crop import Crop, check_crop, choose_person, part_outside, speaker_crop
from data_prep.speaker.faces import Face, median_face
from data_prep.speaker.tracking import Sighting, Track, link, presence

FADE = "a fade or flash"
CAMERA = "camera moves"
TWO_PEOPLE = "two people"
NO_PERSON = "no person"
SMALL_FACE = "face too small"
NOT_FRONTAL = "not frontal"

MIN_FACE = 40.0
"""Height of the smallest face in pixels of the original; the crop has then 168."""

MIN_FRONTAL = 0.25
"""Part of the sightings in which the face must be seen from the front."""

_SAME_PLACE = 1.5
"""Distance in face heights within which a face that is lost and found is the same person's."""


@dataclass(frozen=True)
class Take:
    """A part of a video that was judged, with what cutting it needs.

    Attributes:
        span: the judgement.
        view: the picture between black bars.
        faces: the speaker's, with their frames; in the pixels of the frame `reference` if
            the camera's motion is undone.
        reference: frame to which the camera's motion is undone, or None.
    """

    span: Span
    view: View
    faces: tuple[tuple[int, Face], ...] = ()
    reference: int | None = None


def find_takes(
    analysis: Analysis, info: VideoInfo, config: IngestionConfig, frames: int
) -> list[Take]:
    """Judge a video part by part.

    Args:
        analysis: of the video.
        info: as `probe` returns it.
        config: what to keep.
        frames: of the video that have sound; the others are not judged.

    Raises:
        BadInput: the crop of the configuration lies outside of the picture.
    """
    if config.crop is not None:
        check_crop(config.crop, info.height, info.width)
    takes: list[Take] = []
    for shot in analysis.shots:
        shot = replace(shot, stop=min(shot.stop, frames))
        if shot.stop <= shot.first:
            continue
        view = View(0, 0, info.width, info.height)
        if config.crop is None:
            view = analysis.view(shot, info)
        takes.extend(_judge_shot(analysis, shot, view, config))
    return takes


def _judge_shot(
    analysis: Analysis, shot: Shot, view: View, config: IngestionConfig
) -> Iterator[Take]:
    if shot.faded:
        yield Take(Span(shot.first, shot.stop, FADE), view)
        return
    for first, stop, reference in _steady_parts(analysis, shot, config):
        if stop - first < config.fewest:
            yield Take(Span(first, stop, config.too_short), view)
        elif reference == -1:
            yield Take(Span(first, stop, CAMERA), view)
        else:
            seen = _seen(analysis, first, stop, view, reference)
            if config.crop is not None:
                yield _given(Span(first, stop, crop=config.crop), view, seen, reference)
            else:
                yield from _judge_people(seen, (first, stop), view, config, reference)


def _steady_parts(
    analysis: Analysis, shot: Shot, config: IngestionConfig
) -> Iterator[tuple[int, int, int | None]]:
    """Parts of a shot, and the frame whose camera they are brought to: None as is, -1 moving."""
    camera = analysis.camera
    moving = camera.moving(shot.first, shot.stop)
    breaks = [b for b in camera.breaks if shot.first < b < shot.stop]
    if config.stabilize and moving.any() and not breaks:
        if camera.travel(shot.first, shot.stop) <= FURTHEST:
            yield shot.first, shot.stop, (shot.first + shot.stop) // 2
            return
    for a, b in runs(moving):
        yield shot.first + a, shot.first + b, -1 if moving[a] else None


def runs(values: np.ndarray) -> list[tuple[int, int]]:
    """First and one past the last index of each run of equal values."""
    edges = np.flatnonzero(values[1:] != values[:-1]) + 1
    bounds = [0, *edges.tolist(), len(values)]
    return list(zip(bounds, bounds[1:], strict=False))


def _seen(
    analysis: Analysis, first: int, stop: int, view: View, reference: int | None
) -> list[Sighting]:
    """Faces of a part whose centre is between the bars, with the camera's motion undone."""
    seen = []
    for sighting in analysis.sightings:
        if not first <= sighting.frame < stop:
            continue
        faces = [
            face
            for face in sighting.faces
            if view.left <= face.centre_x < view.right and view.top <= face.centre_y < view.bottom
        ]
        if reference is not None:
            to_reference = analysis.camera.between(sighting.frame, reference)
            faces = [_moved(face, to_reference) for face in faces]
        seen.append(Sighting(sighting.frame, tuple(faces)))
    return seen


def _moved(face: Face, matrix: np.ndarray) -> Face:
    """A face under a similarity that hardly turns."""
    scale = float(np.sqrt(abs(np.linalg.det(matrix[:2, :2]))))
    x, y, _ = (matrix @ (face.centre_x, face.centre_y, 1.0)).tolist()
    w, h = face.w * scale, face.h * scale
    return replace(face, x=x - w / 2, y=y - h / 2, w=w, h=h)


def _given(span: Span, view: View, seen: Sequence[Sighting], reference: int | None) -> Take:
    """A take with the user's own square; the face in it is recorded but not judged."""
    crop = span.crop
    assert crop is not None
    inside = [
        (s.frame, face)
        for s in seen
        for face in s.faces[:1]
        if 0 <= face.centre_x - crop.x < crop.size and 0 <= face.centre_y - crop.y < crop.size
    ]
    face = median_face([face for _, face in inside]) if inside else None
    filled = part_outside(crop, view.height, view.width)
    return Take(replace(span, face=face, filled=filled), view, tuple(inside), reference)


def _judge_people(
    seen: list[Sighting],
    bounds: tuple[int, int],
    view: View,
    config: IngestionConfig,
    reference: int | None,
) -> Iterator[Take]:
    first, stop = bounds
    tracks = link(seen)
    if not tracks:
        yield Take(Span(first, stop, NO_PERSON), view)
        return
    speakers = _speakers(tracks, presence(tracks, first, stop), config.person)
    for a, b in runs(speakers):
        span = Span(first + a, first + b)
        number = int(speakers[a])
        if number < 0:
            yield Take(replace(span, reason=_NOBODY[number]), view)
            continue
        faces = tuple(
            (frame, face)
            for track in _chain(tracks, number)
            for frame, face in track.seen
            if span.first <= frame < span.stop
        )
        if b - a < config.fewest:
            yield Take(replace(span, reason=config.too_short), view, faces)
        else:
            yield _judge_speaker(span, view, faces, reference)


_NOBODY = {-1: NO_PERSON, -2: TWO_PEOPLE}


def _speakers(tracks: Sequence[Track], there: np.ndarray, person: str | None) -> np.ndarray:
    """Number of the speaker's track in each frame; -1 for nobody, -2 for several people.

    Tracks of one person who was lost and found in the same place have the number of the first.
    """
    count = there.sum(axis=0)
    speaker = np.where(count == 0, -1, -2)
    chained = _first_of_chain(tracks)
    faces = [track.face for track in tracks]
    for pattern in np.unique(there, axis=1).T:
        present = np.flatnonzero(pattern)
        if len(present) == 1 or (len(present) and person is not None):
            chosen = choose_person([faces[i] for i in present], person or "largest")
            when = (there == pattern[:, None]).all(axis=0)
            speaker[when] = chained[present[chosen]]
    return speaker


def _first_of_chain(tracks: Sequence[Track]) -> list[int]:
    first = list(range(len(tracks)))
    for j, later in enumerate(tracks):
        for i, earlier in enumerate(tracks[:j]):
            a, b = earlier.face, later.face
            apart = np.hypot(a.centre_x - b.centre_x, a.centre_y - b.centre_y) / max(a.h, b.h)
            if earlier.last < later.first and apart < _SAME_PLACE:
                first[j] = first[i]
                break
    return first


def _chain(tracks: Sequence[Track], number: int) -> list[Track]:
    """The tracks that have a number in `_first_of_chain`."""
    first = _first_of_chain(tracks)
    return [track for track, start in zip(tracks, first, strict=True) if start == number]


def _judge_speaker(
    span: Span, view: View, faces: tuple[tuple[int, Face], ...], reference: int | None
) -> Take:
    if not faces:
        return Take(replace(span, reason=NO_PERSON), view)
    face = median_face([face for _, face in faces])
    inside = replace(face, x=face.x - view.left, y=face.y - view.top)
    crop = speaker_crop(inside, view.height, view.width)
    filled = part_outside(crop, view.height, view.width)
    crop = Crop(crop.x + view.left, crop.y + view.top, crop.size)
    span = replace(span, face=face, crop=crop, filled=filled)
    if face.h < MIN_FACE:
        span = replace(span, reason=SMALL_FACE)
    elif sum(face.frontal for _, face in faces) < MIN_FRONTAL * len(faces):
        span = replace(span, reason=NOT_FRONTAL)
    return Take(span, view, faces, reference)
