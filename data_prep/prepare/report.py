"""The report of a dataset: its numbers as JSON, and one HTML page to judge it by.

The page's layout is `templates/report.html.j2`; it needs no other file.
"""

from base64 import b64encode
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from data_prep.page import drawing, page_template
from data_prep.prepare.record import Record, sheet_path, write_json
from data_prep.prepare.split import SPLITS
from data_prep.prepare.summary import NEGLIGIBLE, REPORT, Summary, counted, seconds_of
from data_prep.rates import FPS

NUMBERS = "report.json"
BINS = 24

MOST = 40
"""Lines of a list that are shown."""

_MOST_SHEETS = 200
"""Sheets inside the page; those of more sources are linked, to keep it light."""

_TITLES = {
    "clip_seconds": "Length of clips in seconds",
    "face_height": "Face height in the video, in pixels",
    "motion": "Motion of clips, mean change of grey level",
}


def page(title: str, numbers: Mapping[str, Any], sheets: Mapping[str, bytes | str]) -> str:
    """Lay out the report.

    Args:
        title: name of the dataset.
        numbers: as `report_numbers` gives them.
        sheets: contact sheets of sources by name: JPEG data, or a path to link to.
    """
    videos = [{**video, "dropped": _readable(video["dropped"])} for video in numbers["videos"]]
    shown = {
        **numbers,
        "dropped": _readable(numbers["dropped"]),
        "videos": videos,
        "sheets": {video["name"]: sheets.get(video["name"]) for video in videos},
        "plots": [
            {"title": _TITLES[name], "svg": _plot(entry)}
            for name, entry in numbers["histograms"].items()
        ],
    }
    template = page_template(
        "data_prep.prepare",
        "report.html.j2",
        time=_time,
        counted=counted,
        base64=lambda data: b64encode(data).decode(),
    )
    return template.render(title=title, SPLITS=SPLITS, MOST=MOST, **shown)


def _time(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.1f} s"
    return f"{seconds / 60:.1f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _readable(dropped: Mapping[str, float]) -> dict[str, float]:
    return {reason: seconds for reason, seconds in dropped.items() if seconds >= NEGLIGIBLE}


def _plot(entry: Mapping[str, list[float]]) -> Markup:
    """A histogram as SVG, with its least and greatest value and its median."""
    if not entry["counts"]:
        return Markup("")
    edges, (median,) = entry["edges"], entry["median"]
    with drawing(3.5, 1.4) as plot:
        (axes,) = plot.axes
        axes.bar(edges[:-1], entry["counts"], np.diff(edges), align="edge", color="#4674c1")
        axes.axvline(median, color="#d9774f")
        axes.set_xticks([edges[0], edges[-1]], [f"{edges[0]:.4g}", f"{edges[-1]:.4g}"])
        axes.set_yticks([])
        axes.spines["left"].set_visible(False)
        axes.set_xlabel(f"median {median:.4g}, highest bar {max(entry['counts']):g}")
    return Markup(plot.svg)


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
    """Content of the report, ready for JSON; durations in seconds."""
    used = {clip.id for clip in summary.clips}
    kept = (entry for r in summary.records for entry in r.outcome.details.items())
    details = [detail for id, detail in kept if id in used]
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
