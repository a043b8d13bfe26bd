"""One source video becomes clips of a dataset."""

import itertools
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from data_prep.clip_files import Piece, fault, piece_of_sound, write_clip
from data_prep.container import check_file
from data_prep.cutting import MIN_FRAMES, clip_bounds
from data_prep.dataset import Clip
from data_prep.errors import BadInput
from data_prep.outcome import ClipDetail, IngestionConfig, Outcome, Span
from data_prep.rates import FPS, SAMPLE_RATE, SAMPLES_PER_FRAME, frames_covering
from data_prep.sound import read_sound
from data_prep.source import Source, sha256
from data_prep.speaker import Crop, Face, check_crop, cut_out, speaker_crop
from data_prep.tracking import speaker_face
from data_prep.video import probe, read_frames
from data_prep.words import Word


def ingest(
    source: Source, folder: Path, config: IngestionConfig, words: list[Word] | None
) -> Outcome:
    """Cut a video into clips and write their files into a dataset folder.

    Whatever is wrong with the video is told in the outcome; nothing is raised for it.

    Args:
        source: the video; where it names intervals, only these are cut.
        folder: the dataset; the folders for the clips' files exist.
        config: how clips are made.
        words: of the whole video, with times as the file counts them; None when unknown.
    """
    outcome = Outcome(source)
    try:
        check_file(source.path)
        outcome.sha256 = sha256(source.path)
        _ingest(outcome, folder, config, words)
    except (BadInput, cv2.error) as error:
        outcome.refused = str(error).removeprefix(f"{source.path}: ")
    if not outcome.clips and outcome.refused is None:
        outcome.refused = f"no clip kept ({', '.join(outcome.dropped)})"
    return outcome


def _ingest(
    outcome: Outcome, folder: Path, config: IngestionConfig, words: list[Word] | None
) -> None:
    source = outcome.source
    info = outcome.info = probe(source.path)
    if not info.has_sound:
        raise BadInput("has no sound")
    samples = read_sound(source.path, SAMPLE_RATE, origin=info.start)
    expected = min(round(info.duration * FPS), frames_covering(len(samples)))
    if expected < MIN_FRAMES:
        raise BadInput(f"shorter than {MIN_FRAMES} frames ({expected})")
    crop, face = config.crop, None
    if crop is None:
        face = speaker_face(source.path, info)
        crop = speaker_crop(face, info.height, info.width)
    check_crop(crop, info.height, info.width)
    outcome.spans.append(Span(0, expected, None, crop, face))
    if words is not None:
        words = [Word(w.word, w.start - info.start, w.end - info.start) for w in words]
    for piece in _pieces(source, samples, _bounds(source, samples, expected, info.start), crop):
        reason = fault(piece)
        if reason is not None:
            outcome.dropped[reason] += round(len(piece.frames) / FPS, 2)  # type: ignore[assignment]
            continue
        write_clip(folder, piece, words)
        start = piece.first / FPS
        clip = Clip(piece.id, source.speaker, "", source.name, start, len(piece.frames))
        outcome.clips.append(clip)
        outcome.details[piece.id] = _detail(piece, face)


def _detail(piece: Piece, face: Face | None) -> ClipDetail:
    grey = [cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY).astype(np.int16) for frame in piece.frames]
    motion = float(np.mean([np.abs(a - b).mean() for a, b in itertools.pairwise(grey)]))
    return ClipDetail(0, 0.0 if face is None else face.h, motion)


def _bounds(
    source: Source, samples: np.ndarray, frames: int, origin: float
) -> list[tuple[int, int]]:
    if not source.intervals:
        return clip_bounds(samples, frames)
    bounds, last = [], 0
    for _, start, end in sorted(source.intervals, key=lambda interval: interval[1:]):
        first = max(round((start - origin) * FPS), last)
        last = max(min(round((end - origin) * FPS), frames), last)
        if last - first >= MIN_FRAMES:
            part = samples[first * SAMPLES_PER_FRAME : last * SAMPLES_PER_FRAME]
            bounds += [(first + a, first + b) for a, b in clip_bounds(part, last - first)]
    return bounds


def _pieces(
    source: Source, samples: np.ndarray, bounds: list[tuple[int, int]], crop: Crop
) -> Iterator[Piece]:
    """The clips one after another; the frames of one are held at a time."""
    frames = read_frames(source.path, FPS)
    at = 0
    for number, (first, stop) in enumerate(bounds):
        cut = [cut_out(frame, crop) for frame in itertools.islice(frames, first - at, stop - at)]
        at = stop
        if cut:
            sound = piece_of_sound(samples, first, len(cut))
            yield Piece(f"{source.name}_{number:03d}", first, cut, sound)
