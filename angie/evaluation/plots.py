"""Plots as inline SVG, without any library."""

from collections.abc import Mapping, Sequence
from html import escape

COLOURS = (
    "#1d2530", "#9aa4b2", "#d9774f", "#e0a020", "#4674c1", "#3a9d5d", "#8d5bb5", "#c2477f",
    "#2f9aa0", "#7a5c3a",
)  # fmt: skip
"""Of the rows in their order, from the start again where there are more."""

_LEFT, _RIGHT, _BOTTOM, _TOP = 46, 12, 34, 10


def colour(index: int) -> str:
    """Colour of the row with this number."""
    return COLOURS[index % len(COLOURS)]


def dots(
    title: str, rows: Sequence[tuple[str, float | None, float | None]], digits: int = 2
) -> str:
    """One dot a row, with the interval where there is one; a row without value says so.

    Args:
        title: above the plot.
        rows: name, value and half of the interval.
        digits: of the values that are written.
    """
    width, name_width, height = 420, 130, 24 * len(rows) + 26
    known = [(v, h or 0.0) for _, v, h in rows if v is not None]
    low = min([0.0, *(v - h for v, h in known)])
    high = max([1e-9, *(v + h for v, h in known)])

    def x(value: float) -> float:
        return name_width + (width - name_width - 70) * (value - low) / (high - low)

    parts = [f"<line x1='{x(0):.1f}' x2='{x(0):.1f}' y1='4' y2='{height - 20}' stroke='#ccd'/>"]
    for index, (name, value, half) in enumerate(rows):
        y = 16 + 24 * index
        parts.append(f"<text x='0' y='{y + 4}'>{escape(name[:22])}</text>")
        if value is None:
            parts.append(f"<text x='{name_width}' y='{y + 4}'>none</text>")
            continue
        if half:
            parts.append(
                f"<line x1='{x(value - half):.1f}' x2='{x(value + half):.1f}' y1='{y}' y2='{y}' "
                f"stroke='{colour(index)}' stroke-width='2'/>"
            )
        parts.append(f"<circle cx='{x(value):.1f}' cy='{y}' r='4.5' fill='{colour(index)}'/>")
        end = x(value + (half or 0)) + 9
        parts.append(f"<text x='{end:.1f}' y='{y + 4}'>{value:.{digits}f}</text>")
    return _figure(title, width, height, parts)


def _figure(title: str, width: int, height: int, parts: Sequence[str]) -> str:
    return (
        f"<figure><figcaption>{escape(title)}</figcaption><svg width='{width}' height='{height}' "
        f"viewBox='0 0 {width} {height}'>{''.join(parts)}</svg></figure>"
    )


def lines(
    title: str,
    curves: Mapping[str, tuple[Sequence[float], Sequence[float | None]]],
    x_label: str,
    y_label: str,
    size: tuple[int, int] = (420, 240),
) -> str:
    """Curves over a common axis; the legend names those that have values.

    Args:
        title: above the plot.
        curves: x and y by row name, in the order of the rows; None leaves a gap.
        x_label: with unit.
        y_label: with unit.
        size: width and height in pixels.
    """
    width, height = size
    xs = [x for x_values, _ in curves.values() for x in x_values]
    ys = [y for _, y_values in curves.values() for y in y_values if y is not None]
    if not xs or not ys:
        return _figure(title, width, 30, ["<text x='0' y='20'>no values</text>"])
    right, top = max(xs), max(max(ys), 1e-9)
    left = min(xs)
    across, down = width - _LEFT - _RIGHT, height - _TOP - _BOTTOM
    parts = _axes(left, right, top, x_label, y_label, size)
    for index, (_, (x_values, y_values)) in enumerate(curves.items()):
        places = [
            f"{_LEFT + across * (x - left) / max(right - left, 1e-9):.1f},"
            f"{_TOP + down * (1 - y / top):.1f}"
            for x, y in zip(x_values, y_values, strict=True)
            if y is not None
        ]
        if places:
            parts.append(
                f"<polyline points='{' '.join(places)}' fill='none' stroke='{colour(index)}' "
                "stroke-width='1.8'/>"
            )
    return _figure(title, width, height, parts)


def _axes(
    left: float, right: float, top: float, x_label: str, y_label: str, size: tuple[int, int]
) -> list[str]:
    width, height = size
    base = height - _BOTTOM
    return [
        f"<line x1='{_LEFT}' x2='{width - _RIGHT}' y1='{base}' y2='{base}' stroke='#99a'/>",
        f"<line x1='{_LEFT}' x2='{_LEFT}' y1='{_TOP}' y2='{base}' stroke='#99a'/>",
        f"<text x='{_LEFT}' y='{base + 14}'>{left:.3g}</text>",
        f"<text x='{width - _RIGHT}' y='{base + 14}' text-anchor='end'>{right:.3g}</text>",
        f"<text x='{(width + _LEFT) / 2}' y='{base + 28}' text-anchor='middle'>"
        f"{escape(x_label)}</text>",
        f"<text x='{_LEFT - 4}' y='{_TOP + 8}' text-anchor='end'>{top:.3g}</text>",
        f"<text x='{_LEFT - 4}' y='{base}' text-anchor='end'>0</text>",
        f"<text x='12' y='{base / 2}' text-anchor='middle' "
        f"transform='rotate(-90 12 {base / 2})'>{escape(y_label)}</text>",
    ]


def activities(title: str, curves: Mapping[str, Sequence[float]], onsets: Sequence[float],
               fps: float) -> str:  # fmt: skip
    """How much moves over time, one band a row, with the onsets of the sound as ticks.

    Args:
        title: above the plot.
        curves: activity of each frame by row name.
        onsets: seconds.
        fps: frames a second.
    """
    width, band, left = 860, 56, 130
    frames = max((len(curve) for curve in curves.values()), default=1)
    top = max((max(curve, default=0) for curve in curves.values()), default=0) or 1.0
    height = band * len(curves) + 20
    across = width - left - 4

    def x(seconds: float) -> float:
        return left + across * seconds * fps / frames

    parts = [
        f"<line x1='{x(t):.1f}' x2='{x(t):.1f}' y1='0' y2='{height - 18}' stroke='#e8d9b0'/>"
        for t in onsets
    ]
    for index, (name, curve) in enumerate(curves.items()):
        base = band * (index + 1) - 4
        places = " ".join(
            f"{x(i / fps):.1f},{base - (band - 10) * value / top:.1f}"
            for i, value in enumerate(curve)
        )
        parts.append(f"<text x='0' y='{base - 16}'>{escape(name[:22])}</text>")
        parts.append(f"<line x1='{left}' x2='{width}' y1='{base}' y2='{base}' stroke='#ccd'/>")
        parts.append(
            f"<polyline points='{places}' fill='none' stroke='{colour(index)}' stroke-width='1.4'/>"
        )
    parts.append(f"<text x='{left}' y='{height - 4}'>0 s</text>")
    parts.append(
        f"<text x='{width}' y='{height - 4}' text-anchor='end'>{frames / fps:.1f} s</text>"
    )
    return _figure(title, width, height, parts)


def legend(names: Sequence[str]) -> str:
    """The rows' names in their colours."""
    return "<p class=legend>" + "".join(
        f"<span><i style='background:{colour(index)}'></i>{escape(name)}</span>"
        for index, name in enumerate(names)
    ) + "</p>"  # fmt: skip
