"""HTML pages that need no other file: Jinja2 templates, and plots as inline SVG by matplotlib."""

import io
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, PackageLoader, StrictUndefined, Template

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LOOK = {
    "svg.hashsalt": "angie",  # else ids, and with them the file, differ from run to run
    "svg.fonttype": "none",
    "text.parse_math": False,
    "font.family": "sans-serif",
    "font.size": 8.5,
    "text.color": "#556",
    "axes.edgecolor": "#99a",
    "axes.labelcolor": "#556",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.color": "#556",
    "ytick.color": "#556",
}


def page_template(package: str, name: str, **filters: Callable[..., Any]) -> Template:
    """A template of a package's folder `templates`; what it shows is escaped.

    Args:
        package: with dots, such as "data_prep.prepare".
        name: of the file.
        filters: functions that the template may apply.
    """
    environment = Environment(
        loader=PackageLoader(package),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    environment.filters.update(filters)
    return environment.get_template(name)


class Drawing:
    """A plot while it is drawn; `svg` holds the element afterwards."""

    axes: Sequence["Axes"]
    svg: str = ""


@contextmanager
def drawing(width: float, height: float, panels: int = 1) -> Iterator[Drawing]:
    """Axes one below the other to draw into, of one x axis; the same plot is the same bytes.

    Args:
        width: inches of 72 points.
        height: inches.
        panels: number of axes.
    """
    import matplotlib
    from matplotlib.figure import Figure

    plot = Drawing()
    with matplotlib.rc_context(_LOOK):  # type: ignore[arg-type]
        figure = Figure((width, height), layout="constrained")
        grid = figure.subplots(panels, 1, sharex=True, squeeze=False)
        plot.axes = list(grid[:, 0])
        yield plot
        file = io.StringIO()
        figure.savefig(file, format="svg", metadata={"Date": None, "Creator": None})
    text = file.getvalue()
    plot.svg = text[text.index("<svg") :]
