"""The page of an evaluation: tables, plots, videos, definitions; only the videos lie beside it."""

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import PurePosixPath
from typing import Any
from urllib.parse import quote

from angie.evaluation import plots
from angie.evaluation.definitions import IMAGES, MOTION, Definition

_STYLE = """
body{font:15px/1.45 system-ui,sans-serif;margin:2em auto;max-width:1280px;padding:0 1em;
 color:#1d2530;background:#fff}
h1{font-size:1.5em;margin:0 0 .2em}h2{font-size:1.2em;margin:2em 0 .5em}
h3{font-size:1em;margin:1.4em 0 .4em}
.wide{overflow-x:auto}table{border-collapse:collapse;font-size:.92em}
td,th{padding:.25em .7em .25em 0;text-align:left;white-space:nowrap}
td.n,th.n{text-align:right;font-variant-numeric:tabular-nums}
th{color:#667;font-weight:500;vertical-align:bottom}tr.line td{border-top:1px solid #dde}
.soft{color:#667}.none{color:#aab}small{color:#667}
.warn{background:#fff6e0;border-left:4px solid #e0a020;padding:.5em .9em;margin:.6em 0}
figure{margin:0 1.5em 1.2em 0;display:inline-block;vertical-align:top}
figcaption{font-weight:500;margin-bottom:.3em}svg text{font:11px system-ui,sans-serif;fill:#556}
.legend span{margin-right:1.2em;white-space:nowrap}
.legend i{display:inline-block;width:12px;height:12px;border-radius:3px;margin-right:.4em}
video{display:block;max-width:100%;margin:.3em 0 1.2em}code{font-size:.92em}
dt{font-weight:500;margin-top:.5em}dd{margin:0 0 0 1.2em;color:#445}
"""


def page(title: str, numbers: Mapping[str, Any]) -> str:
    """Lay out the report.

    Args:
        title: name of the dataset.
        numbers: as `report.numbers_of` gives them.
    """
    parts = [_head(title, numbers)]
    for space in numbers["spaces"]:
        parts += _space(space, several=len(numbers["spaces"]) > 1)
    parts += [_definitions(), _origin(numbers)]
    return (
        f"<!doctype html><html lang=en><meta charset=utf-8><title>{escape(title)}</title>"
        f"<meta name=viewport content='width=device-width'><style>{_STYLE}</style>\n"
        + "\n".join(part for part in parts if part)
        + "\n</html>\n"
    )


def _head(title: str, numbers: Mapping[str, Any]) -> str:
    data = numbers["dataset"]
    return (
        f"<h1>Evaluation on {escape(title)}</h1><p>{data['test_clips']} test clips, "
        f"{data['test_minutes']:.1f} minutes of {escape(', '.join(data['speakers']))}; "
        f"{data['train_clips']} training clips, {data['train_minutes']:.1f} minutes. "
        f"{data['fps']} frames a second. Numbers after &plusmn; are half of the 95 % interval of "
        "the mean over runs with different seeds.</p>"
    )


def _space(space: Mapping[str, Any], several: bool) -> list[str]:
    rows = space["rows"]
    names = [row["name"] for row in rows]
    parts = []
    if several:
        parts.append(
            f"<h2>Regions of {escape(', '.join(space['bundles']) or 'the estimator')} "
            f"<code>{space['estimator'][:12]}</code></h2><p class=soft>Scores of different regions "
            "cannot be compared.</p>"
        )
    parts += [
        "<h2>Motion</h2>",
        _warnings(space),
        _table(rows, MOTION),
        _about(rows),
        _plots(space, names),
        _speakers(space),
    ]
    if space["images"] is not None:
        parts += [
            "<h2>Images</h2><p>From each clip's first frame, against the recorded frames. "
            + escape(space["images"]["about"])
            + "</p>",
            _table(space["images"]["rows"], IMAGES),
            _about(space["images"]["rows"]),
        ]
    if space["videos"]:
        parts.append("<h2>Videos</h2><p class=soft>What is synthetic is marked in the files.</p>")
        parts += [
            f"<div>{escape(PurePosixPath(name).stem)}"
            f"<video controls preload=metadata src='{quote(name)}'></video></div>"
            for name in space["videos"]
        ]
    parts.append(_missing(rows + (space["images"]["rows"] if space["images"] else [])))
    return parts


def cell(summary: Mapping[str, Any], digits: int) -> str:
    """Value and interval as HTML."""
    if summary["mean"] is None:
        return f"<td class='n none' title='{escape(summary['reason'], quote=True)}'>none</td>"
    half = summary["interval"]
    more = f" <small>&plusmn;{half:.{digits}f}</small>" if half is not None else ""
    return f"<td class=n>{summary['mean']:.{digits}f}{more}</td>"


def _table(rows: Sequence[Mapping[str, Any]], columns: Sequence[Definition]) -> str:
    heads = "".join(
        f"<th class=n title='{escape(c.text, quote=True)}'>{escape(c.title)} "
        f"{_ARROWS[c.better.split()[0]]}<br><small>{escape(c.unit)}</small></th>"
        for c in columns
    )
    lines = "".join(
        f"<tr class=line><td><b>{escape(row['name'])}</b></td><td class=n>{row['runs']}</td>"
        + "".join(cell(row["scores"][c.key], c.digits) for c in columns)
        + "</tr>"
        for row in rows
    )
    head = f"<tr><th></th><th class=n>runs</th>{heads}</tr>"
    return f"<div class=wide><table>{head}{lines}</table></div>"


_ARROWS = {"higher": "&uarr;", "lower": "&darr;", "nearest": "&asymp;"}


def _about(rows: Sequence[Mapping[str, Any]]) -> str:
    return "".join(
        f"<div class=soft><b>{escape(row['name'])}</b>: {escape(row['about'])}</div>"
        for row in rows
    )


def _warnings(space: Mapping[str, Any]) -> str:
    lines = space["warnings"]
    if not lines:
        return ""
    return "<div class=warn>" + "".join(f"<div>{escape(x)}</div>" for x in lines) + "</div>"


def _plots(space: Mapping[str, Any], names: Sequence[str]) -> str:
    rows = space["rows"]
    shown = {c.key: c for c in MOTION}
    figures = [
        plots.dots(
            f"{shown[key].title} ({shown[key].better})",
            [(r["name"], r["scores"][key]["mean"], r["scores"][key]["interval"]) for r in rows],
            shown[key].digits,
        )
        for key in ("fgd", "bc", "pmb", "diversity", "hellinger", "acceleration")
    ]
    curves = {
        r["name"]: ([float(x) for x in r["pmb_curve"]], list(r["pmb_curve"].values())) for r in rows
    }
    speeds = {r["name"]: (space["speed_bins"], r["speeds"]) for r in rows}
    kind = space["kind"]
    unit = "px" if kind == "regions" else "units"
    figures += [
        plots.lines("Matched beats over the threshold", curves, "threshold, s", "PMB, %"),
        plots.lines(
            f"Speed of the active {kind}", speeds, f"mean speed, {unit}/s", "share of slower frames"
        ),
    ]
    activity = space["activity"]
    bands = plots.activities(
        f"Activity in {activity['clip']}, run 1, and the onsets of its sound",
        activity["curves"],
        activity["onsets"],
        space["fps"],
    )
    return plots.legend(names) + "".join(figures) + f"<div class=wide>{bands}</div>"


def _speakers(space: Mapping[str, Any]) -> str:
    speakers = list(space["rows"][0]["by_speaker"])
    if len(speakers) < 2:
        return ""
    keys = [c for c in MOTION if c.key in ("fgd", "bc", "diversity")]
    heads = "".join(
        f"<th class=n>{escape(s)}<br><small>{c.title}</small></th>" for s in speakers for c in keys
    )
    lines = ""
    for row in space["rows"]:
        cells = "".join(
            cell(row["by_speaker"][s][c.key], c.digits)
            if s in row["by_speaker"]
            else "<td class='n none'>none</td>"
            for s in speakers
            for c in keys
        )
        lines += f"<tr class=line><td><b>{escape(row['name'])}</b></td>{cells}</tr>"
    return (
        f"<h3>By speaker</h3><div class=wide><table><tr><th></th>{heads}</tr>{lines}</table></div>"
    )


def _missing(rows: Sequence[Mapping[str, Any]]) -> str:
    titles = {c.key: c.title for c in (*MOTION, *IMAGES)}
    lines: dict[str, list[str]] = {}
    for row in rows:
        for key, summary in row["scores"].items():
            if summary["mean"] is None:
                lines.setdefault(f"{row['name']}: {summary['reason']}", []).append(titles[key])
    if not lines:
        return ""
    text = "".join(
        f"<div><b>{escape(', '.join(keys))}</b> of {escape(why)}</div>"
        for why, keys in lines.items()
    )
    return f"<h3>Not available</h3><div class=soft>{text}</div>"


def _definitions() -> str:
    items = "".join(
        f"<dt>{escape(c.title)} <small>{escape(c.better)}"
        f"{', ' + escape(c.unit) if c.unit else ''}</small></dt><dd>{escape(c.text)}</dd>"
        for c in (*MOTION, *IMAGES)
    )
    what = "All positions are region centres, or joints where the dataset is one of joints."
    return f"<h2>Definitions</h2><p>{what}</p><dl>{items}</dl>"


def _origin(numbers: Mapping[str, Any]) -> str:
    lines = [
        ("angie", f"{numbers['angie']} {numbers['commit'][:12]}"),
        ("dataset", f"{numbers['dataset']['name']}, sha256 {numbers['dataset']['sha256']}"),
        *((k.replace("_", " "), str(v)) for k, v in numbers["options"].items()),
    ]
    for space in numbers["spaces"]:
        whose = "renderer" if space["kind"] == "regions" else "joints of the dataset"
        lines.append(("motion", f"{space['kind']}, {whose} sha256 {space['estimator']}"))
        for key, value in space["origin"].items():
            lines.append((key, str(value)))
    rows = "".join(
        f"<tr><td>{escape(k)}</td><td><code>{escape(v)}</code></td></tr>" for k, v in lines
    )
    return f"<h2>Origin</h2><div class=wide><table>{rows}</table></div>"
