"""What became of each source, kept in the dataset: a run goes on by what these records say."""

import hashlib
import json
import os
from collections import Counter
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from data_prep.dataset import Clip
from data_prep.media.video import VideoInfo
from data_prep.prepare.clips import FOLDERS
from data_prep.prepare.source import ClipDetail, IngestionConfig, Outcome, Source, Span
from data_prep.speaker.crop import Crop, Face

PROCEDURE = 3
"""Version of how videos become clips: raised when the same video comes out otherwise."""

RECORDS = "sources"
"""Folder of the records, and of the contact sheets."""


@dataclass(frozen=True)
class Record:
    """A source that is done.

    Attributes:
        key: hash of all that decides the outcome; "" for an accident, which is tried again.
        outcome: what became of it.
        config: how its clips were made.
        words: number of words of its transcript, None without one.
        warnings: what went wrong without harm to the clips.
        sheet: size of its contact sheet in bytes, 0 for none.
        files: size of each file of its clips, by path in the dataset.
    """

    key: str
    outcome: Outcome
    config: IngestionConfig
    words: int | None = None
    warnings: tuple[str, ...] = ()
    sheet: int = 0
    files: dict[str, int] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Of the source."""
        return self.outcome.source.name

    @property
    def clips(self) -> list[Clip]:
        """That were kept, without splits."""
        return self.outcome.clips


def key_of(source: Source, video: str, transcript: str, config: IngestionConfig) -> str:
    """Hash of all that decides what becomes of a source.

    Args:
        source: its name, speaker and intervals count, not its path.
        video: sha256 of the file.
        transcript: name and sha256 of the transcript, "" for none.
        config: how clips are made.
    """
    what = [PROCEDURE, source.name, source.speaker, source.intervals, video, transcript]
    what += [source.person] if source.person else []
    return hashlib.sha256(json.dumps([*what, asdict(config)]).encode()).hexdigest()


def files_of(folder: Path) -> dict[str, int]:
    """Size of every file in the `FOLDERS` of a dataset, by path in it."""
    return {
        f"{kind}/{path.name}": path.stat().st_size
        for kind in FOLDERS
        for path in sorted((folder / kind).iterdir())
    }


def record_path(folder: Path, name: str) -> Path:
    """Where the record of a source lies in a dataset."""
    return folder / RECORDS / f"{name}.json"


def sheet_path(folder: Path, name: str) -> Path:
    """Where the contact sheet of a source lies in a dataset."""
    return folder / RECORDS / f"{name}.jpg"


def write_json(path: Path, content: Any) -> None:
    """Write JSON that appears whole, with a line for each entry."""
    text = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False, default=_bare)
    part = path.with_name(f".{path.name}.part")
    part.write_text(text + "\n", encoding="utf-8", errors="replace")  # names may be no text
    os.replace(part, path)


def _bare(value: Any) -> Any:
    """A NumPy number as Python's own."""
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} has no place in JSON")


def write_record(folder: Path, record: Record) -> None:
    """Write a record; it appears whole."""
    outcome = record.outcome
    source = {
        "name": outcome.source.name,
        "file": outcome.source.path.name,
        "speaker": outcome.source.speaker,
        "intervals": outcome.source.intervals,
        "person": outcome.source.person,
    }
    content = {
        "key": record.key,
        "source": source,
        "sha256": outcome.sha256,
        "info": None if outcome.info is None else asdict(outcome.info),
        "config": asdict(record.config),
        "spans": [asdict(span) for span in outcome.spans],
        "clips": [asdict(clip) for clip in outcome.clips],
        "details": {clip: asdict(detail) for clip, detail in outcome.details.items()},
        "dropped": {reason: round(s, 2) for reason, s in sorted(outcome.dropped.items())},
        "refused": outcome.refused,
        "words": record.words,
        "warnings": record.warnings,
        "sheet": record.sheet,
        "files": record.files,
    }
    write_json(record_path(folder, record.name), content)


def read_record(path: Path) -> Record | None:
    """Read a record; None where it is of another version or damaged (its source is done again)."""
    if not path.is_file():
        return None
    try:
        content = json.loads(path.read_bytes())
        record = _record(content)
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return record if record.name == path.stem else None


def _record(content: dict[str, Any]) -> Record:
    entry = content["source"]
    intervals = tuple((str(i), float(a), float(b)) for i, a, b in entry["intervals"])
    file, person = Path(entry["file"]), entry.get("person", "")
    source = Source(file, entry["speaker"], entry["name"], intervals, person)
    config = content["config"]
    crop = config.pop("crop")
    info = content["info"]
    outcome = Outcome(
        source,
        content["sha256"],
        None if info is None else VideoInfo(**info),
        [_span(span) for span in content["spans"]],
        [Clip(**clip) for clip in content["clips"]],
        {clip: ClipDetail(**detail) for clip, detail in content["details"].items()},
        Counter(content["dropped"]),
        content["refused"],
    )
    return Record(
        content["key"],
        outcome,
        IngestionConfig(crop=None if crop is None else Crop(**crop), **config),
        content["words"],
        tuple(content["warnings"]),
        content["sheet"],
        content["files"],
    )


def _span(entry: dict[str, Any]) -> Span:
    crop, face = entry.pop("crop"), entry.pop("face")
    return Span(
        **entry,
        crop=None if crop is None else Crop(**crop),
        face=None if face is None else Face(**face),
    )


def is_whole(folder: Path, record: Record) -> bool:
    """Whether all files of a record exist with the sizes recorded."""
    sizes = {folder / path: size for path, size in record.files.items()}
    if record.sheet:
        sizes[sheet_path(folder, record.name)] = record.sheet
    return all(path.is_file() and path.stat().st_size == size for path, size in sizes.items())


def read_records(folder: Path) -> dict[str, Record]:
    """Records of a dataset, by the names of the sources; damaged ones and their like left out."""
    records = map(read_record, sorted((folder / RECORDS).glob("*.json")))
    return {r.name: r for r in records if r is not None and is_whole(folder, r)}
