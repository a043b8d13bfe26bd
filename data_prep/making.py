"""One source from start to end: its transcript, its clips, its contact sheet, its record."""

import errno
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import cv2

from data_prep.clip_files import FOLDERS
from data_prep.contact_sheet import write_sheet
from data_prep.errors import BadInput
from data_prep.ingestion import ingest
from data_prep.outcome import IngestionConfig, Outcome
from data_prep.rates import SAMPLE_RATE
from data_prep.record import Record, files_of
from data_prep.sound import read_sound
from data_prep.source import Source
from data_prep.transcript import read_transcript
from data_prep.video import probe
from data_prep.words import Word

LEAST_ROOM = 4 << 20
"""Bytes that must be free for a failure not to be the disk's."""


@dataclass(frozen=True)
class Order:
    """A source that is to be made.

    Attributes:
        source: the video.
        sha256: of the file.
        key: what its record will be recognised by.
        config: how its clips are made.
        transcript: the file beside it, or None.
        folder: where to make it; not there yet.
    """

    source: Source
    sha256: str
    key: str
    config: IngestionConfig
    transcript: Path | None
    folder: Path


def make_source(order: Order) -> Record:
    """Make the files of a source in a folder of its own.

    Nothing is raised for what is wrong with the video: its record tells it.

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
        words, warnings = _words(order)
        outcome = ingest(order.source, order.folder, order.config, words)
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


def check_room(folder: Path) -> None:
    """Stop where a disk is full: whatever failed there failed of it.

    Raises:
        OSError: less than `LEAST_ROOM` is free.
    """
    if shutil.disk_usage(folder).free < LEAST_ROOM:
        what = "no space is left on the disk; make room and repeat the command, it goes on there"
        raise OSError(errno.ENOSPC, what, str(folder))


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
