"""The page of an evaluation: tables, plots, videos, definitions; only the videos lie beside it.

Its layout is `templates/report.html.j2`. The plots are inline SVG by matplotlib, the same bytes for
the same numbers.
"""

from collections.abc import Mapping, Sequence
from itertools import chain
from typing import Any

from markupsafe import Markup

from angie.evaluation.definitions import ALL, IMAGES, MOTION, PEOPLE
from data_prep.page import drawing, page_template

COLOURS = (
    "#1d2530", "#9aa4b2", "#d9774f", "#e0a020", "#4674c1", "#3a9d5d", "#8d5bb5", "#c2477f",
    "#2f9aa0", "#7a5c3a",
)  # fmt: skip
"""Of the rows in their order, from the start again where there are more."""

ARROWS = {"higher": "\u2191", "lower": "\u2193", "nearest": "\u2248"}
"""By the first word of `Definition.better`."""

DOTS = ("fgd", "bc", "pmb", "diversity", "hellinger", "acceleration")
"""Scores that have a plot of one dot a row."""

BY_SPEAKER = ("fgd", "bc", "diversity")
"""Columns of the table by speaker."""

NAME = 22
"""Letters of a row's name in a plot, at most."""

_SMALL = (5.6, 3.2)
_WIDE = 11.4
"""Inches of 72 points: of a plot, and the width of the plot of activities."""


def page(title: str, numbers: Mapping[str, Any]) -> str:
    """Lay out the report as HTML."""
    spaces = [
        {
            **space,
            "legend": [(row["name"], colour(i)) for i, row in enumerate(space["rows"])],
            "plots": plots(space),
            "missing": _missing(space),
        }
        for space in numbers["spaces"]
    ]
    return page_template("angie.evaluation", "report.html.j2").render(
        title=title,
        dataset=numbers["dataset"],
        spaces=spaces,
        motion=MOTION,
        images=IMAGES,
        people=PEOPLE,
        speaker_columns=[c for c in MOTION if c.key in BY_SPEAKER],
        arrows=ARROWS,
        origin=_origin(numbers),
    )


def _missing(space: Mapping[str, Any]) -> dict[str, list[str]]:
    """Titles of the columns without a value, by row and reason."""
    titles = {c.key: c.title for c in ALL}
    found: dict[str, list[str]] = {}
    drawn = [space[part]["rows"] for part in ("images", "people") if space[part]]
    for row in chain(space["rows"], *drawn):
        for key, score in row["scores"].items():
            if score["mean"] is None:
                found.setdefault(f"{row['name']}: {score['reason']}", []).append(titles[key])
    return found


def _origin(numbers: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Inputs, options and versions behind the report, by name."""
    lines = [
        ("angie", f"{numbers['angie']} {numbers['commit'][:12]}"),
        ("dataset", f"{numbers['dataset']['name']}, sha256 {numbers['dataset']['sha256']}"),
        *((key.replace("_", " "), str(value)) for key, value in numbers["options"].items()),
    ]
    for space in numbers["spaces"]:
        whose = "renderer" if space["kind"] == "regions" else "joints of the dataset"
        lines.append(("motion", f"{space['kind']}, {whose} sha256 {space['estimator']}"))
        lines += [(key, str(value)) for key, value in space["origin"].items()]
    return lines


def colour(index: int) -> str:
    """Colour of the row with this number."""
    return COLOURS[index % len(COLOURS)]


def plots(space: Mapping[str, Any]) -> list[dict[str, str]]:
    """The plots of a space, each a title and its SVG."""
    rows, kind, shown = space["rows"], space["kind"], space["activity"]
    columns = {c.key: c for c in MOTION}
    figures = [
        (f"{columns[key].title} ({columns[key].better})", _dots(rows, key, columns[key].digits))
        for key in DOTS
    ]
    matched = [([float(x) for x in r["pmb_curve"]], list(r["pmb_curve"].values())) for r in rows]
    figures.append(("Matched beats over the threshold", _lines(matched, "threshold, s", "PMB, %")))
    speeds = [(space["speed_bins"], row["speeds"]) for row in rows]
    unit = "px" if kind == "regions" else "units"
    label = f"mean speed, {unit}/s"
    figures.append((f"Speed of the active {kind}", _lines(speeds, label, "share of slower frames")))
    figures.append(
        (
            f"Activity in {shown['clip']}, run 1, and the onsets of its sound",
            _activities(shown["curves"], shown["onsets"], space["fps"]),
        )
    )
    for styles in space.get("styles", []):
        figures.append(
            (f"Styles of {styles['row']}, by principal components", _styles(styles, kind))
        )
    return [{"title": title, "svg": Markup(svg)} for title, svg in figures]


def _styles(styles: Mapping[str, Any], kind: str) -> str:
    """Styles drawn of each speaker, with the speed of its gestures and on which side they are."""
    unit = "px/s" if kind == "regions" else "units/s"
    with drawing(*_SMALL) as plot:
        (axes,) = plot.axes
        for index, (name, points) in enumerate(styles["points"].items()):
            x, y = zip(*points, strict=True)
            axes.scatter(x, y, s=9, color=colour(index), alpha=0.5, lw=0)
            label = f"{name}: {styles['speed'][name]:.3g} {unit}, {styles['right'][name]:.0%} right"
            axes.annotate(
                label, (sum(x) / len(x), sum(y) / len(y)), ha="center", color=colour(index)
            )
        axes.set(xlabel=f"{styles['share']:.0%} of the variance in both", yticks=[])
        axes.margins(x=0.3, y=0.15)
    return plot.svg


def _dots(rows: Sequence[Mapping[str, Any]], key: str, digits: int) -> str:
    """One dot a row, with its interval where there is one; a row without a value says so."""
    with drawing(_SMALL[0], 0.32 * len(rows) + 0.3) as plot:
        (axes,) = plot.axes
        for index, row in enumerate(rows):
            value, half = row["scores"][key]["mean"], row["scores"][key]["interval"]
            if value is None:
                axes.annotate("none", (0, index), (4, 0), textcoords="offset points", va="center")
                continue
            axes.errorbar(value, index, xerr=half, fmt="o", ms=5, lw=1.8, color=colour(index))
            axes.annotate(
                f"{value:.{digits}f}", (value + (half or 0), index), (8, 0),
                textcoords="offset points", va="center",
            )  # fmt: skip
        axes.axvline(0, color="#ccd", lw=1, zorder=0)
        axes.margins(x=0.16)
        axes.set_ylim(len(rows) - 0.5, -0.5)
        axes.set_yticks(range(len(rows)), [row["name"][:NAME] for row in rows])
        axes.tick_params("y", length=0)
        axes.xaxis.set_visible(False)
        axes.spines[["left", "bottom"]].set_visible(False)
    return plot.svg


def _lines(
    curves: Sequence[tuple[Sequence[float], Sequence[float | None]]], x_label: str, y_label: str
) -> str:
    """A curve a row, x and y of each; a None leaves a gap."""
    with drawing(*_SMALL) as plot:
        (axes,) = plot.axes
        for index, (x, y) in enumerate(curves):
            axes.plot(x, [float("nan") if v is None else v for v in y], color=colour(index))
        axes.set(xlabel=x_label, ylabel=y_label)
        axes.set_ylim(bottom=0)
        axes.margins(x=0)
    return plot.svg


def _activities(curves: Mapping[str, Sequence[float]], onsets: Sequence[float], fps: float) -> str:
    """How much moves over time, a panel a row, with the onsets of the sound as lines."""
    top = max((max(curve, default=0) for curve in curves.values()), default=0) or 1.0
    with drawing(_WIDE, 0.75 * len(curves) + 0.5, max(len(curves), 1)) as plot:
        for index, (axes, name) in enumerate(zip(plot.axes, curves, strict=False)):
            for onset in onsets:
                axes.axvline(onset, color="#e8d9b0", lw=1, zorder=0)
            seconds = [frame / fps for frame in range(len(curves[name]))]
            axes.plot(seconds, curves[name], color=colour(index), lw=1.4)
            axes.set_ylim(0, top)
            axes.set_yticks([])
            axes.set_ylabel(name[:NAME], rotation=0, ha="right", va="center")
            axes.margins(x=0)
        plot.axes[-1].set_xlabel("s")
    return plot.svg
