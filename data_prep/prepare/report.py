"""The report of a dataset: its numbers as JSON, and a page that a person can judge it by.

The page of a dataset's report: one HTML file that needs nothing else.
"""

import base64
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from data_prep.prepare.outcome import ClipDetail
from data_prep.prepare.record import Record, sheet_path, write_json
from data_prep.prepare.split import SPLITS
from data_prep.prepare.summary import NEGLIGIBLE, REPORT, Summary, counted, seconds_of
from data_prep.rates import FPS

_STYLE = """
body{font:15px/1.45 system-ui,sans-serif;margin:2em auto;max-width:1200px;padding:0 1em;
 color:#1d2530;background:#fff}
h1{font-size:1.5em;margin:0 0 .2em}h2{font-size:1.15em;margin:1.8em 0 .5em}
.big{font-size:1.15em;margin:.2em 0 1em}.row{display:flex;gap:2em;flex-wrap:wrap}
table{border-collapse:collapse}td,th{padding:.2em .8em .2em 0;text-align:left}
td.n,th.n{text-align:right;font-variant-numeric:tabular-nums}th{color:#667;font-weight:500}
.bar{display:flex;height:22px;border-radius:4px;overflow:hidden;margin:.4em 0;max-width:900px}
.bar span{display:block}.good{background:#3a9d5d}.bad{background:#d9774f}
.warn{background:#fff6e0;border-left:4px solid #e0a020;padding:.5em .9em;margin:.6em 0}
.warn div{margin:.15em 0}.video{border-top:1px solid #dde;padding:.8em 0}
.video img{display:block;max-width:100%;border-radius:4px;margin:.4em 0}
.refused{color:#b3401d}.soft{color:#667}b.name{font-size:1.05em}
svg text{font:11px system-ui,sans-serif;fill:#667}
"""


_COLOURS = {"train": "#3a9d5d", "val": "#e0a020", "test": "#4674c1"}


_MOST_NAMES = 40


_MOST_SPANS = 40


def page(title: str, numbers: Mapping[str, Any], sheets: Mapping[str, bytes | str]) -> str:
    """Lay out the report.

    Args:
        title: name of the dataset.
        numbers: as `report.report_numbers` gives them.
        sheets: contact sheets of sources by name: JPEG data, or a path to link to.
    """
    parts = [
        _head(title, numbers),
        _warnings(numbers["warnings"]),
        _speakers(numbers["speakers"]),
        _dropped(numbers["dropped"]),
        _missing_section(numbers["pats_missing"]),
        _histograms(numbers["histograms"]),
        "<h2>Videos</h2><p class=soft>Green: what was cut out. Red border: a part that was "
        "refused.</p>",
        *(_video_section(video, sheets.get(video["name"])) for video in numbers["videos"]),
    ]
    return (
        f"<!doctype html><html lang=en><meta charset=utf-8><title>{escape(title)}</title>"
        f"<meta name=viewport content='width=device-width'><style>{_STYLE}</style>\n"
        + "\n".join(part for part in parts if part)
        + "\n</html>\n"
    )


def _time(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.1f} s"
    return f"{seconds / 60:.1f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _head(title: str, numbers: Mapping[str, Any]) -> str:
    seconds = numbers["seconds"]
    share = seconds["kept"] / seconds["given"] if seconds["given"] else 0.0
    refused = sum(video["refused"] is not None for video in numbers["videos"])
    return (
        f"<h1>{escape(title)}</h1><p class=big><b>{_time(seconds['kept'])}</b> kept of "
        f"{_time(seconds['given'])} ({share:.0%}), {counted(numbers['clips'], 'clip')} from "
        f"{numbers['sources'] - refused} of {numbers['sources']} videos</p>"
        f"<div class=bar style='background:#d9774f'>"
        f"<span class=good style='width:{100 * share:.1f}%'></span></div>"
    )


def _warnings(lines: list[str]) -> str:
    if not lines:
        return ""
    shown = "".join(f"<div>{escape(line)}</div>" for line in lines[:_MOST_NAMES])
    more = len(lines) - _MOST_NAMES
    return f"<div class=warn>{shown}{f'<div>and {more} more</div>' if more > 0 else ''}</div>"


def _speakers(speakers: Mapping[str, Any]) -> str:
    heads = "".join(f"<th class=n>{split}</th>" for split in SPLITS)
    rows = []
    for name, entry in speakers.items():
        cells = "".join(
            f"<td class=n>{_time(part['seconds'])}, {counted(part['clips'], 'clip')}"
            f" ({part['seconds'] / max(entry['seconds'], 1e-9):.0%})</td>"
            for part in entry["splits"].values()
        )
        strip = "".join(
            f"<span style='background:{_COLOURS[split]};"
            f"width:{100 * part['seconds'] / max(entry['seconds'], 1e-9):.1f}%'></span>"
            for split, part in entry["splits"].items()
        )
        rows.append(
            f"<tr><td><b>{escape(name)}</b></td><td class=n>{_time(entry['seconds'])}</td>{cells}"
            f"<td>{escape(entry['rule'])}</td>"
            f"<td><div class=bar style='width:160px;height:12px'>{strip}</div></td></tr>"
        )
    return (
        f"<h2>Speakers and splits</h2><table><tr><th>speaker</th><th class=n>kept</th>{heads}"
        f"<th>divided</th><th></th></tr>{''.join(rows)}</table>"
    )


def _dropped(dropped: Mapping[str, float]) -> str:
    dropped = _readable(dropped)
    if not dropped:
        return ""
    most = max(dropped.values())
    rows = "".join(
        f"<tr><td>{escape(reason)}</td><td class=n>{_time(seconds)}</td><td>"
        f"<div class=bar style='width:300px;height:12px'><span class=bad "
        f"style='width:{100 * seconds / most:.1f}%'></span></div></td></tr>"
        for reason, seconds in dropped.items()
    )
    return f"<h2>Dropped, by reason</h2><table>{rows}</table>"


def _readable(dropped: Mapping[str, float]) -> dict[str, float]:
    return {reason: seconds for reason, seconds in dropped.items() if seconds >= NEGLIGIBLE}


def _missing_section(missing: Mapping[str, Any] | None) -> str:
    if not missing or not missing["intervals"]:
        return ""
    reasons = "".join(
        f"<tr><td>{escape(reason)}</td><td class=n>{count}</td></tr>"
        for reason, count in missing["reasons"].items()
    )
    names = ", ".join(escape(name) for name in missing["videos"][:_MOST_NAMES])
    more = len(missing["videos"]) - _MOST_NAMES
    return (
        f"<h2>PATS: {missing['intervals']} intervals missing</h2><table>{reasons}</table>"
        f"<p class=soft>{names}{f' and {more} more' if more > 0 else ''}; all of them in "
        "pats_missing.csv</p>"
    )


def _histograms(histograms: Mapping[str, Any]) -> str:
    titles = {
        "clip_seconds": "Length of clips in seconds",
        "face_height": "Face height in the video, in pixels",
        "motion": "Motion of clips, mean change of grey level",
    }
    plots = "".join(_plot(titles[name], entry) for name, entry in histograms.items())
    return f"<h2>Clips</h2><div class=row>{plots}</div>"


def _plot(title: str, entry: Mapping[str, list[float]]) -> str:
    """A histogram as SVG, with its least and greatest value and its median."""
    width, height, base = 340, 130, 96
    if not entry["counts"]:
        return f"<div>{title}<br><span class=soft>nothing to count</span></div>"
    edges, counts = entry["edges"], entry["counts"]
    step, top = width / len(counts), max(counts)
    bars = "".join(
        f"<rect x='{i * step + 0.5:.1f}' y='{base - 90 * count / top:.1f}' "
        f"width='{step - 1:.1f}' height='{90 * count / top:.1f}' fill='#4674c1'/>"
        for i, count in enumerate(counts)
        if count
    )
    (median,) = entry["median"]
    place = width * (median - edges[0]) / (edges[-1] - edges[0])
    return (
        f"<div>{title}<br><svg width='{width}' height='{height}'>{bars}"
        f"<line x1='0' x2='{width}' y1='{base}' y2='{base}' stroke='#99a'/>"
        f"<line x1='{place:.1f}' x2='{place:.1f}' y1='2' y2='{base}' stroke='#d9774f'/>"
        f"<text x='0' y='112'>{edges[0]:.4g}</text>"
        f"<text x='{width}' y='112' text-anchor='end'>{edges[-1]:.4g}</text>"
        f"<text x='{width / 2}' y='126' text-anchor='middle'>median {median:.4g}, "
        f"highest bar {top:g}</text></svg></div>"
    )


def _video_section(video: Mapping[str, Any], sheet: bytes | str | None) -> str:
    told = [video["picture"], _time(video["seconds"]), f"speaker {video['speaker']}"]
    if video["refused"] is None:
        told.append(f"kept {_time(video['kept'])} in {counted(video['clips'], 'clip')}")
        told.append("/".join(video["splits"]))
    if video["words"] is not None:
        told.append(f"{video['words']} words")
    line = escape(", ".join(text for text in told if text))
    parts = [f"<b class=name>{escape(video['file'])}</b> <span class=soft>{line}</span>"]
    if video["refused"] is not None:
        parts.append(f"<div class=refused>refused: {escape(video['refused'])}</div>")
    elif dropped := _readable(video["dropped"]):
        text = ", ".join(f"{_time(s)} {reason}" for reason, s in dropped.items())
        parts.append(f"<div class=soft>dropped: {escape(text)}</div>")
    if isinstance(sheet, bytes):
        data = base64.b64encode(sheet).decode()
        parts.append(f"<img src='data:image/jpeg;base64,{data}' alt=''>")
    elif sheet is not None:
        parts.append(f"<div><a href='{escape(sheet)}'>contact sheet</a></div>")
    parts.append(_spans(video["spans"]))
    return f"<div class=video>{''.join(parts)}</div>"


def _spans(spans: list[dict[str, Any]]) -> str:
    if len(spans) < 2:
        return ""
    rows = "".join(
        f"<tr><td class=n>{span['start']:.1f} to {span['end']:.1f} s</td>"
        f"<td class='{'refused' if span['reason'] else ''}'>"
        f"{escape(span['reason'] or 'used')}</td><td class=soft>{_face(span)}</td></tr>"
        for span in spans[:_MOST_SPANS]
    )
    more = len(spans) - _MOST_SPANS
    rest = f"<tr><td>and {more} more</td></tr>" if more > 0 else ""
    return f"<details><summary>{len(spans)} parts</summary><table>{rows}{rest}</table></details>"


def _face(span: Mapping[str, Any]) -> str:
    told = []
    if span["face_height"] is not None:
        told.append(f"face {span['face_height']:.0f} px")
    if span["filled"] > 0:
        told.append(f"{span['filled']:.0%} of the crop lies outside of the picture")
    return ", ".join(told)


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
