"""Progress of long work: a bar with rate and time left on a terminal's standard error."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, TextColumn, TimeRemainingColumn
from rich.progress import Task as RichTask
from rich.text import Text

console = Console(stderr=True)
"""Messages to the person; standard output carries results alone."""


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
        `advance(amount=1, note="")`: moves the bar; `note` is shown at its end.
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

        def advance(amount: float = 1, note: str = "") -> None:
            bar.update(task, advance=amount)
            if note:
                bar.update(task, note=note)

        yield advance
