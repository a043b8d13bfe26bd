"""The report of a dataset: its numbers as JSON, and a page that a person can judge it by."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from data_prep.outcome import ClipDetail
from data_prep.rates import FPS
from data_prep.record import Record, sheet_path, write_json
from data_prep.report_page import page
from data_prep.split import SPLITS
from data_prep.summary import REPORT, Summary, seconds_of

NUMBERS = "report.json"

BINS = 24

_MOST_SHEETS = 200
"""Sheets inside of the page; those of more sources are linked, to keep it light."""


def write_report(folder: Path, summary: Summary) -> None:
    """Write `report.json` and `report.html`; the same dataset gives the same files.

    Args:
        folder: the dataset, with the contact sheets of all sources.
        summary: what is in it.
    """
    numbers = report_numbers(summary)
    write_json(folder / NUMBERS, numbers)
    sheets: dict[str, bytes | str] = {}
    for count, record in enumerate(r for r in summary.records if r.sheet):
        path = sheet_path(folder, record.name)
        inside = count < _MOST_SHEETS
        sheets[record.name] = path.read_bytes() if inside else f"{path.parent.name}/{path.name}"
    text = page(summary.path.name, numbers, sheets)
    (folder / REPORT).write_text(text, encoding="utf-8", errors="replace")


def report_numbers(summary: Summary) -> dict[str, Any]:
    """All that the report tells, ready for JSON; durations in seconds."""
    details = _details(summary)
    given = sum(r.outcome.info.duration for r in summary.records if r.outcome.info)
    heights = [detail.face_height for detail in details if detail.face_height > 0]
    return {
        "clips": len(summary.clips),
        "sources": len(summary.records),
        "seconds": {
            "given": round(given, 2),
            "kept": round(seconds_of(summary.clips), 2),
            "dropped": round(sum(summary.dropped.values()), 2),
        },
        "dropped": summary.dropped,
        "speakers": {speaker: _speaker(summary, speaker) for speaker in summary.split.rules},
        "warnings": summary.warnings,
        "pats_missing": None if summary.missing is None else _missing(summary),
        "histograms": {
            "clip_seconds": histogram([clip.n_frames / FPS for clip in summary.clips]),
            "face_height": histogram(heights),
            "motion": histogram([detail.motion for detail in details]),
        },
        "videos": [_video(summary, record) for record in summary.records],
    }


def histogram(values: Sequence[float]) -> dict[str, list[float]]:
    """Counts of values between their least and their greatest, `BINS` bins, and the median."""
    if not values:
        return {"edges": [], "counts": [], "median": []}
    low, high = min(values), max(values)
    counts, edges = np.histogram(values, BINS, (low, high if high > low else low + 1.0))
    return {
        "edges": [round(float(edge), 3) for edge in edges],
        "counts": counts.tolist(),
        "median": [round(float(np.median(values)), 3)],
    }


def _details(summary: Summary) -> list[ClipDetail]:
    used = {clip.id for clip in summary.clips}
    return [d for r in summary.records for id, d in r.outcome.details.items() if id in used]


def _speaker(summary: Summary, speaker: str) -> dict[str, Any]:
    own = [clip for clip in summary.clips if clip.speaker == speaker]
    parts = {split: [clip for clip in own if clip.split == split] for split in SPLITS}
    return {
        "rule": summary.split.rules[speaker],
        "clips": len(own),
        "seconds": round(seconds_of(own), 2),
        "splits": {
            split: {
                "clips": len(part),
                "seconds": round(seconds_of(part), 2),
                "sources": len({clip.source for clip in part}),
            }
            for split, part in parts.items()
        },
    }


def _missing(summary: Summary) -> dict[str, Any]:
    reasons: dict[str, int] = {}
    for entry in summary.missing or ():
        reasons[entry.reason] = reasons.get(entry.reason, 0) + 1
    files = sorted({m.interval.file or m.interval.link for m in summary.missing or ()})
    return {
        "intervals": len(summary.missing or ()),
        "reasons": dict(sorted(reasons.items(), key=lambda item: (-item[1], item[0]))),
        "videos": files,
    }


def _video(summary: Summary, record: Record) -> dict[str, Any]:
    outcome = record.outcome
    clips = summary.clips_of(record)
    info = outcome.info
    return {
        "name": record.name,
        "file": outcome.source.path.name,
        "speaker": outcome.source.speaker,
        "picture": None if info is None else f"{info.width}x{info.height}, {info.fps:.4g} fps",
        "seconds": round(info.duration, 2) if info else 0.0,
        "kept": round(seconds_of(clips), 2),
        "clips": len(clips),
        "splits": [split for split in SPLITS if any(c.split == split for c in clips)],
        "words": record.words,
        "dropped": summary.dropped_of(record),
        "refused": outcome.refused,
        "warnings": list(record.warnings),
        "spans": [
            {
                "start": round(span.first / FPS, 2),
                "end": round(span.stop / FPS, 2),
                "reason": span.reason,
                "crop": None if span.crop is None else [span.crop.x, span.crop.y, span.crop.size],
                "face_height": None if span.face is None else round(span.face.h, 1),
                "filled": round(span.filled, 3),
            }
            for span in outcome.spans
        ],
    }
