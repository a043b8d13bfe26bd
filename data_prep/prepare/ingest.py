"""One source video from start to end: its transcript, clips, contact sheet and record."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from data_prep.dataset import Clip
from data_prep.errors import BadInput, collected_notes
from data_prep.files import sha256
from data_prep.media.audio import AUDIBLE, read_sound
from data_prep.media.container import check_file
from data_prep.media.video import VideoInfo, probe, read_frames
from data_prep.prepare.analysis import Analysis, analyse
from data_prep.prepare.clips import (
    FOLDERS,
    Piece,
    clip_bounds,
    fault,
    piece_of_sound,
    tracking_fault,
    write_clip,
)
from data_prep.prepare.contact_sheet import write_sheet
from data_prep.prepare.record import Record, files_of
from data_prep.prepare.source import ClipDetail, IngestionConfig, Outcome, Source, Span
from data_prep.prepare.spans import NO_PERSON, TWO_PEOPLE, Take, find_takes
from data_prep.prepare.workplace import check_room
from data_prep.rates import FPS, SAMPLE_RATE, SAMPLES_PER_FRAME, frames_covering
from data_prep.speaker.crop import Crop, Detector, cut_out
from data_prep.speaker.networks import face_detector
from data_prep.speech.transcript import read_transcript
from data_prep.speech.words import Word

SOUND_OVER = "after the end of the sound"
_SILENT = "--silent-ok keeps it for training the renderer"

_REMEDIES = {
    TWO_PEOPLE: "choose with --person left, right or largest, or give --crop x,y,size",
    NO_PERSON: "where there is one, give --crop x,y,size",
}


@dataclass(frozen=True)
class _Plan:
    """A clip to be cut: its frames, and the take (with its number) that they belong to."""

    first: int
    stop: int
    number: int
    take: Take


def ingest(
    source: Source,
    folder: Path,
    config: IngestionConfig,
    words: list[Word] | None = None,
    models: Path | None = None,
) -> Outcome:
    """Cut a video into clips and write their files into a dataset folder.

    The video is decoded twice: small and grey to find shots, camera motion, people and black
    bars; then to cut the clips. The frames of one clip are held at a time. Whatever is wrong
    with the video is recorded in the outcome; nothing is raised for it.

    Args:
        source: the video; where it names intervals, only these are cut.
        folder: the dataset; the folders for the clips' files exist.
        config: what to keep and how.
        words: of the whole video, with times as the file counts them; None when unknown.
        models: folder with the network that finds faces, None for the cascades alone.
    """
    outcome = Outcome(source)
    try:
        check_file(source.path)
        outcome.sha256 = sha256(source.path)
        _ingest(outcome, folder, config, words, face_detector(models))
    except (BadInput, cv2.error) as error:
        outcome.refused = str(error).removeprefix(f"{source.path}: ")
    if not outcome.clips and outcome.refused is None:
        outcome.refused = _why_nothing(outcome)
    return outcome


def _ingest(
    outcome: Outcome,
    folder: Path,
    config: IngestionConfig,
    words: list[Word] | None,
    detector: Detector | None,
) -> None:
    source = outcome.source
    info = outcome.info = probe(source.path)
    if not info.has_sound and not config.silent_ok:
        raise BadInput(f"has no sound; {_SILENT}")
    analysis = analyse(source.path, info, detector=detector)
    samples = _sound(source, info, analysis, config.silent_ok)
    frames = min(analysis.frames, frames_covering(len(samples)))
    if frames < config.fewest:
        remedy = "" if config.silent_ok else f"; {_SILENT}"
        raise BadInput(f"{config.too_short} ({frames}){remedy}")
    takes = find_takes(analysis, info, config, frames)
    outcome.spans = [take.span for take in takes]
    if frames < analysis.frames:
        outcome.spans.append(Span(frames, analysis.frames, SOUND_OVER))
    for span in outcome.spans:
        if span.reason is not None:
            outcome.dropped[span.reason] += (span.stop - span.first) / FPS  # type: ignore[assignment]
    if words is not None:
        words = [Word(w.word, w.start - info.start, w.end - info.start) for w in words]
    parts = _intervals(source, info.start) or [(0, frames)]
    plans = list(_plans(takes, parts, samples, config))
    for plan, piece in _pieces(source, samples, plans, analysis):
        reason = fault(piece, config) or tracking_fault(plan.take, plan.first, plan.stop)
        if reason is not None:
            outcome.dropped[reason] += len(piece.frames) / FPS  # type: ignore[assignment]
            continue
        write_clip(folder, piece, words)
        clip = Clip(
            piece.id, source.speaker, "", source.name, piece.first / FPS, len(piece.frames),
            source.person,
        )  # fmt: skip
        height = 0.0 if plan.take.span.face is None else plan.take.span.face.h
        outcome.clips.append(clip)
        outcome.details[clip.id] = ClipDetail(plan.number, height, float(piece.changes.mean()))


def _sound(source: Source, info: VideoInfo, analysis: Analysis, silent_ok: bool) -> np.ndarray:
    if not info.has_sound:
        return np.zeros(analysis.frames * SAMPLES_PER_FRAME, np.float32)
    samples = read_sound(source.path, SAMPLE_RATE, origin=info.start)
    if np.abs(samples).max() < AUDIBLE and not silent_ok:
        raise BadInput(f"its sound is silence; {_SILENT}")
    return samples


def _intervals(source: Source, origin: float) -> list[tuple[int, int]]:
    """First and one past the last frame of each interval of a source; none overlap."""
    parts: list[tuple[int, int]] = []
    last = 0
    for _, start, end in sorted(source.intervals, key=lambda interval: interval[1:]):
        first = max(round((start - origin) * FPS), last)
        last = max(round((end - origin) * FPS), first)
        parts.append((first, last))
    return parts


def _plans(
    takes: list[Take], parts: list[tuple[int, int]], samples: np.ndarray, config: IngestionConfig
) -> Iterator[_Plan]:
    """Clips within the takes that are used and the parts of the video that are asked for."""
    shortest = max(round(config.shortest * FPS), config.fewest)
    longest = max(round(config.longest * FPS), shortest)
    for number, take in enumerate(takes):
        if take.span.reason is not None:
            continue
        for low, high in parts:
            first, stop = max(take.span.first, low), min(take.span.stop, high)
            if stop - first < config.fewest:
                continue
            sound = samples[first * SAMPLES_PER_FRAME : stop * SAMPLES_PER_FRAME]
            for a, b in clip_bounds(sound, stop - first, shortest, longest):
                yield _Plan(first + a, first + b, number, take)


def _pieces(
    source: Source, samples: np.ndarray, plans: list[_Plan], analysis: Analysis
) -> Iterator[tuple[_Plan, Piece]]:
    """The clips one after another; the frames of one are held at a time."""
    if not plans:
        return
    frames = read_frames(source.path, FPS, [(plan.first, plan.stop) for plan in plans])
    for number, plan in enumerate(plans):
        cut = [
            _cut(frame, plan.take, analysis, plan.first + k)
            for k, frame in enumerate(itertools.islice(frames, plan.stop - plan.first))
        ]
        sound = piece_of_sound(samples, plan.first, len(cut))
        yield plan, Piece(f"{source.name}_{number:03d}", plan.first, cut, sound)


def _cut(frame: np.ndarray, take: Take, analysis: Analysis, number: int) -> np.ndarray:
    crop, view = take.span.crop, take.view
    assert crop is not None
    inner = view.of(frame)
    if take.reference is not None:
        matrix = analysis.camera.between(number, take.reference)
        shift = np.array([[1.0, 0, view.left], [0, 1, view.top], [0, 0, 1]])
        inner = cv2.warpAffine(
            inner,
            (np.linalg.inv(shift) @ matrix @ shift)[:2],
            (view.width, view.height),
            flags=cv2.INTER_CUBIC,
            borderMode=cv2.BORDER_REPLICATE,
        )
    return cut_out(inner, Crop(crop.x - view.left, crop.y - view.top, crop.size))


def _why_nothing(outcome: Outcome) -> str:
    parts = [f"{reason} ({seconds:.1f} s)" for reason, seconds in outcome.dropped.most_common()]
    why = ", ".join(parts) or "no clip kept"
    remedy = next((_REMEDIES[r] for r, _ in outcome.dropped.most_common(1) if r in _REMEDIES), "")
    return f"{why}; {remedy}" if remedy else why


@dataclass(frozen=True)
class Order:
    """A source to be cut into clips.

    Attributes:
        source: the video.
        sha256: of the file.
        key: what its record will be recognised by.
        config: how its clips are made.
        transcript: the file beside it, or None.
        folder: where to make it; not there yet.
        models: folder with the network that finds faces.
    """

    source: Source
    sha256: str
    key: str
    config: IngestionConfig
    transcript: Path | None
    folder: Path
    models: Path | None = None


def make_source(order: Order) -> Record:
    """Make the files of a source in a folder of its own.

    Nothing is raised for what is wrong with the video; its record says it.

    Raises:
        OSError: the disk is full. That is no video's fault, and the next run goes on there.
    """
    for name in FOLDERS:
        (order.folder / name).mkdir(parents=True)
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)  # the number of processes must not decide on what is found
    try:
        return _make(order)
    finally:
        cv2.setNumThreads(threads)


def _make(order: Order) -> Record:
    words: list[Word] | None = None
    warnings: list[str] = []
    key = order.key
    try:
        with collected_notes() as notes:
            words, warnings = _words(order)
            outcome = ingest(order.source, order.folder, order.config, words, order.models)
        warnings += [text.removeprefix(f"{order.source.path}: ") for text in notes]
    except Exception as error:  # one video out of hundreds must not end the night's work
        what = " ".join(f"{type(error).__name__}: {error}".split())
        refused = f"failed unexpectedly ({what}); please report it"
        outcome = Outcome(order.source, order.sha256, refused=refused)
        key = ""
    if outcome.refused is not None:
        check_room(order.folder)
        outcome = replace(outcome, clips=[], details={})
        warnings = []
        for name in FOLDERS:
            for path in (order.folder / name).iterdir():
                path.unlink()
    return Record(
        key,
        outcome,
        order.config,
        None if words is None else len(words),
        tuple(warnings),
        write_sheet(order.folder / "sheet.jpg", outcome),
        files_of(order.folder),
    )


def _words(order: Order) -> tuple[list[Word] | None, list[str]]:
    """Words with times as the file counts them, and what is wrong with the transcript."""
    if order.transcript is None:
        return None, []
    path = order.source.path
    try:
        transcript = read_transcript(order.transcript)
        if not transcript.text:
            return transcript.words, []
        origin = probe(path).start
        words = transcript.aligned(read_sound(path, SAMPLE_RATE, origin=origin))
        if not words:
            return None, [f"{order.transcript.name}: no speech is heard to align the text with"]
        return [Word(w.word, w.start + origin, w.end + origin) for w in words], []
    except BadInput as error:
        about = str(error).replace(f"{order.transcript.parent}/", "")
        return None, [f"{about}; went on without words"]


def died(order: Order) -> Record:
    """The record of a source whose process died: tried again by the next run."""
    reason = "the process that read it died (out of memory, or a fault of the decoder)"
    return Record("", Outcome(order.source, order.sha256, refused=reason), order.config)
