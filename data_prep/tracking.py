"""Where the speaker of a video is: one face for the whole of it."""

from pathlib import Path

import numpy as np

from data_prep.errors import BadInput
from data_prep.speaker import Face, find_faces, median_face
from data_prep.video import VideoInfo, read_frames

SAMPLING = 2.0
"""Frames a second in which the face is looked for."""

MAX_SAMPLES = 120
"""Frames looked at in a long video."""

MIN_SHARE = 0.5
"""Part of the sampled frames in which the speaker's face must be found."""

_NEARBY = 1.5
"""Distance, in face heights, within which faces are taken for the same person's."""


def speaker_face(path: Path, info: VideoInfo) -> Face:
    """The face of a video's speaker: the median over the frames in which it is found.

    In each sampled frame the face is sought where it was before, else in the whole picture,
    where the largest counts. The place in which most faces are found is the speaker's.

    Args:
        path: the video.
        info: what `probe` tells of it.

    Raises:
        BadInput: the face is found in less than `MIN_SHARE` of the sampled frames.
    """
    rate = min(SAMPLING, MAX_SAMPLES / max(info.duration, 1.0))
    faces: list[Face] = []
    near: Face | None = None
    samples = 0
    for frame in read_frames(path, rate):
        samples += 1
        found = find_faces(frame, near) if near is not None else []
        found = found or find_faces(frame)
        near = found[0] if found else None
        faces.extend(found[:1])
    together = _most_frequent(faces)
    if not faces or len(together) < MIN_SHARE * samples:
        raise BadInput(
            f"{path}: one face in {len(together)} of {samples} sampled frames; "
            "give the square yourself with --crop x,y,size"
        )
    return median_face(together)


def _most_frequent(faces: list[Face]) -> list[Face]:
    """The largest set of faces near one of them."""
    if not faces:
        return []
    boxes = np.array([(face.centre_x, face.centre_y, face.h) for face in faces])
    apart = np.hypot(*(boxes[:, None, :2] - boxes[None, :, :2]).transpose(2, 0, 1))
    size = boxes[:, 2] / boxes[:, 2][:, None]
    same = (apart < _NEARBY * boxes[:, 2][:, None]) & (size > 0.6) & (size < 1 / 0.6)
    best = same[np.argmax(same.sum(axis=1))]
    return [face for face, near in zip(faces, best, strict=True) if near]
