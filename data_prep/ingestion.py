"""One source video becomes clips of a dataset."""

import itertools
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from data_prep.clip_files import Piece, fault, piece_of_sound, write_clip
from data_prep.container import check_file
from data_prep.cutting import MIN_FRAMES, clip_bounds
from data_prep.dataset import Clip
from data_prep.errors import BadInput
from data_prep.rates import FPS, SAMPLE_RATE, frames_covering
from data_prep.sound import read_sound
from data_prep.source import Source, sha256
from data_prep.speaker import Crop, check_crop, cut_out, speaker_crop
from data_prep.tracking import speaker_face
from data_prep.video import VideoInfo, probe, read_frames
from data_prep.words import Word, read_words


@dataclass
class Outcome:
    """What became of a source.

    Attributes:
        source: the video.
        sha256: of the file.
        info: what the file holds, None when it could not be read.
        crop: square that was cut out, None when the video was refused before.
        clips: that were kept; their splits are not decided yet.
        dropped: number of clips dropped, by reason.
        refused: why nothing of the video was kept, or None.
    """

    source: Source
    sha256: str = ""
    info: VideoInfo | None = None
    crop: Crop | None = None
    clips: list[Clip] = field(default_factory=list)
    dropped: Counter[str] = field(default_factory=Counter)
    refused: str | None = None


def ingest(source: Source, folder: Path, crop: Crop | None = None) -> Outcome:
    """Cut a video into clips and write their files into a dataset folder.

    Whatever is wrong with the video is told in the outcome; nothing is raised for it.

    Args:
        source: the video.
        folder: the dataset; the folders for the clips' files exist.
        crop: square of the picture; None finds it by the speaker's face.
    """
    outcome = Outcome(source)
    try:
        check_file(source.path)
        outcome.sha256 = sha256(source.path)
        _ingest(outcome, folder, crop)
    except (BadInput, cv2.error) as error:
        outcome.refused = str(error).removeprefix(f"{source.path}: ")
    if not outcome.clips and outcome.refused is None:
        outcome.refused = f"no clip kept ({', '.join(outcome.dropped)})"
    return outcome


def _ingest(outcome: Outcome, folder: Path, crop: Crop | None) -> None:
    source = outcome.source
    info = outcome.info = probe(source.path)
    if not info.has_sound:
        raise BadInput("has no sound")
    samples = read_sound(source.path, SAMPLE_RATE, origin=info.start)
    expected = min(round(info.duration * FPS), frames_covering(len(samples)))
    if expected < MIN_FRAMES:
        raise BadInput(f"shorter than {MIN_FRAMES} frames ({expected})")
    words = _words(source.path, info.start)
    if crop is None:
        face = speaker_face(source.path, info)
        crop = speaker_crop(face, info.height, info.width)
    check_crop(crop, info.height, info.width)
    outcome.crop = crop
    for piece in _pieces(source, samples, clip_bounds(samples, expected), crop):
        reason = fault(piece)
        if reason is not None:
            outcome.dropped[reason] += 1
            continue
        write_clip(folder, piece, words)
        start = piece.first / FPS
        outcome.clips.append(
            Clip(piece.id, source.speaker, "", source.name, start, len(piece.frames))
        )


def _pieces(
    source: Source, samples: np.ndarray, bounds: list[tuple[int, int]], crop: Crop
) -> Iterator[Piece]:
    """The clips one after another; the frames of one are held at a time."""
    frames = read_frames(source.path, FPS)
    for number, (first, stop) in enumerate(bounds):
        cut = [cut_out(frame, crop) for frame in itertools.islice(frames, stop - first)]
        if cut:
            sound = piece_of_sound(samples, first, len(cut))
            yield Piece(f"{source.name}_{number:03d}", first, cut, sound)


def _words(path: Path, origin: float) -> list[Word] | None:
    """Words from the file `<video's stem>.words.json` beside a video, timed from `origin`."""
    beside = path.with_suffix(".words.json")
    if not beside.exists():
        return None
    return [Word(w.word, w.start - origin, w.end - origin) for w in read_words(beside)]
