"""The files of a report: results.json, table.csv, report.html; and the table on a terminal."""

import csv
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from angie.evaluation.definitions import ALL, IMAGES, MOTION, PEOPLE, SHORT
from angie.evaluation.page import page
from angie.evaluation.rows import Performance, Row
from angie.evaluation.scoring import Judge, Summary, matched_curve, score_motion, summarise_runs
from angie.evaluation.space import RegionSpace, points
from angie.metrics.score import Score
from data_prep.speech.synchrony import activity, steps

MARK = "results.json"
"""File that every report holds."""

SPEED_BINS = 40
FASTEST = 99.5
"""Percentile of the true speed at which the plot of speeds ends."""

BY_SPEAKER = ("fgd", "bc", "pmb", "diversity", "hellinger", "acceleration")


def gesture_speed(run: Sequence[Performance], judge: Judge) -> list[NDArray]:
    """Mean speed (T - 1,) of what gestures in each performance, pixels or units a second."""
    scale = judge.fps * (judge.pixel or 1.0)
    return [steps(points(p.motion)[:, judge.active])[1:].mean(1) * scale for p in run]


def speed_bins(run: Sequence[Performance], judge: Judge) -> NDArray:
    """Speeds (41,) of the plot, as `gesture_speed`, up to what is true motion's."""
    speeds = np.concatenate(gesture_speed(run, judge))
    return np.linspace(0, max(float(np.percentile(speeds, FASTEST)), 1e-6), SPEED_BINS + 1)


def numbers_of_row(row: Row, judge: Judge, bins: NDArray) -> dict[str, Any]:
    """All motion scores of a row, over all and by speaker, and the data of its plots."""
    runs = [score_motion(run, judge) for run in row.runs]
    speakers = sorted({p.speaker for p in row.runs[0] if p.speaker is not None})
    by_speaker = {}
    for speaker in speakers:
        only = judge.only(speaker)
        parts = [score_motion([p for p in run if p.speaker == speaker], only) for run in row.runs]
        whole = summarise_runs(parts)
        by_speaker[speaker] = {key: whole[key].as_dict() for key in BY_SPEAKER}
    curves = [matched_curve(run, judge) for run in row.runs]
    speeds = np.concatenate([s for run in row.runs for s in gesture_speed(run, judge)])
    slower = np.searchsorted(np.sort(speeds), bins, side="right") / max(len(speeds), 1)
    return {
        "name": row.name,
        "about": row.about,
        "runs": len(row.runs),
        "clips": len(row.runs[0]),
        "scores": {key: part.as_dict() for key, part in summarise_runs(runs).items()},
        "by_speaker": by_speaker,
        "pmb_curve": {f"{near}": _mean([c[near] for c in curves]) for near in curves[0]},
        "speeds": slower.tolist(),
    }


def _mean(scores: Sequence[Score]) -> float | None:
    values = [score.value for score in scores if score.value is not None]
    return float(np.mean(values)) if len(values) == len(scores) else None


def numbers_of_images(name: str, about: str, scores: Mapping[str, Score]) -> dict[str, Any]:
    """Image scores of a row."""
    return {
        "name": name,
        "about": about,
        "runs": 1,
        "scores": {
            key: Summary(score.value, None, score.reason, [score]).as_dict()
            for key, score in scores.items()
        },
    }


def activities(rows: Sequence[Row], judge: Judge, clip: str) -> dict[str, Any]:
    """Activity of each row's first run over one clip, and the onsets of its sound."""
    curves, onsets = {}, np.zeros(0)
    for row in rows:
        for p in row.runs[0]:
            if p.clip == clip:
                moved = steps(points(p.motion)[:, judge.active])
                curves[row.name] = activity(moved, judge.usual).round(4).tolist()
                if len(p.onsets) > len(onsets):
                    onsets = p.onsets
    return {"clip": clip, "curves": curves, "onsets": onsets.round(4).tolist()}


def numbers_of_space(
    space: RegionSpace,
    judge: Judge,
    rows: Sequence[Row],
    numbers: list[dict[str, Any]],
    shown: str,
    bins: NDArray,
    origin: Mapping[str, Any],
    bundles: Mapping[str, Any],
) -> dict[str, Any]:
    """What the report says of the motion in one space.

    `numbers` are `numbers_of_row` of each row, `shown` is the clip whose activity is plotted,
    `bins` are the plot's speeds; `origin` says what was used, `bundles` describes them.
    """
    return {
        "kind": space.kind,
        "estimator": space.estimator,
        "bundles": bundles,
        "fps": judge.fps,
        "active_regions": np.flatnonzero(space.active).tolist(),
        "true_windows": len(judge.windows.raw),
        "warnings": warnings_of(numbers),
        "rows": numbers,
        "activity": activities(rows, judge, shown),
        "speed_bins": bins.tolist(),
        "origin": origin,
    }


def warnings_of(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Warnings of the scores, each once."""
    titles = {definition.key: definition.title for definition in ALL}
    found: dict[str, None] = {}
    for row in rows:
        for key, summary in row["scores"].items():
            text = next((run["warning"] for run in summary["runs"] if run["warning"]), "")
            if text:
                found[f"{titles[key]}: {text}"] = None
    return list(found)


def write_report(folder: Path, title: str, numbers: Mapping[str, Any]) -> None:
    """Write results.json, table.csv and report.html into a folder.

    Raises:
        ValueError: a number is not finite.
    """
    text = json.dumps(numbers, indent=1, allow_nan=False, ensure_ascii=False)
    (folder / MARK).write_text(text + "\n", encoding="utf-8")
    (folder / "report.html").write_text(page(title, numbers), encoding="utf-8")
    with (folder / "table.csv").open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        head = [
            "regions",
            "part",
            "row",
            "runs",
            "score",
            "unit",
            "mean",
            "half_interval",
            "reason",
        ]
        table.writerow(head)
        for space in numbers["spaces"]:
            parts = [("motion", MOTION, space["rows"])]
            for part, columns in (("images", IMAGES), ("people", PEOPLE)):
                if space[part] is not None:
                    parts.append((part, columns, space[part]["rows"]))
            for part, columns, rows in parts:
                for row in rows:
                    for c in columns:
                        s = row["scores"][c.key]
                        values = [
                            "" if v is None else f"{v:.6g}" for v in (s["mean"], s["interval"])
                        ]
                        start = [space["estimator"][:12], part, row["name"], row["runs"]]
                        table.writerow([*start, c.key, c.unit, *values, s["reason"]])


def terminal_table(numbers: Mapping[str, Any]) -> str:
    """The most read columns as text."""
    lines = []
    for space in numbers["spaces"]:
        if len(numbers["spaces"]) > 1:
            lines.append(f"regions {space['estimator'][:12]}")
        keys = [key if space["kind"] == "regions" else key.removesuffix("_px") for key in SHORT]
        lines += _aligned(space["rows"], [c for c in MOTION if c.key in keys])
        for part, columns in (("images", IMAGES), ("people", PEOPLE)):
            rows = [] if space[part] is None else space[part]["rows"]
            there = {k for row in rows for k, v in row["scores"].items() if v["mean"] is not None}
            if rows:
                lines += ["", *_aligned(rows, [c for c in columns if c.key in there])]
    return "\n".join(lines)


def _aligned(rows: Sequence[Mapping[str, Any]], columns: Sequence[Any]) -> list[str]:
    cells = [["", *(f"{c.title}{', ' + c.unit if c.unit not in c.title else ''}" for c in columns)]]
    for row in rows:
        line = [row["name"]]
        for c in columns:
            s = row["scores"][c.key]
            if s["mean"] is None:
                line.append("-")
                continue
            half = "" if s["interval"] is None else f" +-{s['interval']:.{c.digits}f}"
            line.append(f"{s['mean']:.{c.digits}f}{half}")
        cells.append(line)
    widths = [max(len(line[i]) for line in cells) for i in range(len(cells[0]))]
    return [
        "  ".join(
            text.ljust(width) if i == 0 else text.rjust(width)
            for i, (text, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in cells
    ]
