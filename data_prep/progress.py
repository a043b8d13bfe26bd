"""Progress of long work: a bar with rate and time left on a terminal's standard error."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, TextColumn, TimeRemainingColumn
from rich.progress import Task as RichTask
from rich.text import Text

if TYPE_CHECKING:
    from numpy.typing import NDArray

console = Console(stderr=True)
"""Messages to the person; standard output carries results only."""


@dataclass(frozen=True)
class Step:
    """How far a piece of work is.

    Attributes:
        label: what is being done, such as "render".
        done: units that are done.
        total: units of the whole work, None when unknown.
        unit: name of one unit.
        picture: the last one drawn, (H, W, 3) uint8 RGB, where pictures are drawn.
    """

    label: str
    done: float
    total: float | None
    unit: str = "steps"
    picture: "NDArray | None" = None


Listener = Callable[[Step], None]
"""What is told how far work is; it may raise `data_prep.errors.Cancelled` to stop it."""

_listener: ContextVar[Listener | None] = ContextVar("listener", default=None)


@contextmanager
def listening(listener: Listener | None) -> Iterator[None]:
    """Tell `listener` of all work in the block, in this thread; None leaves it as it is.

    What the listener raises ends the work where it stands; nothing is left half-written.
    """
    if listener is None:
        yield
        return
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


def tell(step: Step) -> None:
    """Tell whoever listens how far work is."""
    listener = _listener.get()
    if listener is not None:
        listener(step)


class _Rate(ProgressColumn):
    def __init__(self, unit: str) -> None:
        super().__init__()
        self.unit = unit

    def render(self, task: RichTask) -> Text:
        speed = task.finished_speed or task.speed
        return Text("" if speed is None else f"{speed:.1f} {self.unit}/s")


@contextmanager
def progress(
    label: str, total: float | None, unit: str = "steps", done: float = 0
) -> Iterator[Callable[..., None]]:
    """Show a bar while the block runs; off when standard error is not a terminal.

    Args:
        label: what is being done.
        total: units of the whole work, None when unknown.
        unit: name of one unit, for the rate.
        done: units done before (a resumed run).

    Yields:
        `advance(amount=1, note="", picture=None)`: moves the bar; `note` is shown at its end, and
        who is `listening` is told, with the picture.
    """
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:.0f}/{task.total:.0f}" if total else "{task.completed:.0f}"),
        _Rate(unit),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}"),
    )
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task(label, total=total, note="")
        bar.update(task, completed=done)

        reached = done

        def advance(amount: float = 1, note: str = "", picture: "NDArray | None" = None) -> None:
            nonlocal reached
            reached += amount
            bar.update(task, advance=amount)
            if note:
                bar.update(task, note=note)
            tell(Step(label, reached, total, unit, picture))

        tell(Step(label, done, total, unit))
        yield advance
