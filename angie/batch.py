"""Many videos from a list: loaded once, past what fails, and resumed by running it again.

The list is a CSV file with the columns photo, audio, output, and any option of `angie animate` by
its name; files are looked for from the list's folder. Beside it a report is written after every
video: `LIST.report.csv` with the row, the output, what became of it, and why.
"""

import csv
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, fields, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

from angie.provenance import hash_of, read_origin
from angie.request import Pipelines, Request
from data_prep.cluster import spread_on_ray
from data_prep.errors import BadInput
from data_prep.files import check_apart, check_output, whole_file
from data_prep.media.formats import format_of
from data_prep.progress import console, progress
from data_prep.table import read_table

MOST = 100_000
"""Rows of a list."""


@dataclass(frozen=True)
class Row:
    """A row of a list.

    Attributes:
        number: of the row below the header, from 1.
        output: the video to write; None where the row cannot be read.
        request: what is asked for; None where that cannot be.
        problem: why it cannot be, or nothing.
    """

    number: int
    output: Path | None
    request: Request | None
    problem: str = ""


@dataclass(frozen=True)
class Outcome:
    """What became of a row: `status` is "made", "there" (from an earlier run) or "failed"."""

    row: int
    output: str
    status: str
    frames: int = 0
    seconds: float = 0.0
    message: str = ""


def read_list(path: Path, usual: Mapping[str, Any] | None = None) -> list[Row]:
    """Read a list of jobs.

    Args:
        path: of the CSV file.
        usual: options for rows that do not name them.

    Raises:
        BadInput: no such file, no table, unknown columns, or two rows with one output.
    """
    cells = read_table(path, ("photo", "output"), "; give photo, audio and output")
    if not cells or len(cells) > MOST:
        raise BadInput(f"{path}: has {len(cells)} rows; give 1 to {MOST}")
    known = {entry.name for entry in fields(Request)} | {"output"}
    unknown = [name for name in cells[0] if name.replace("-", "_") not in known]
    if unknown:
        names = ", ".join(sorted(known))
        raise BadInput(f"{path}: has an unknown column {unknown[0]!r}; there are {names}")
    rows = [_row(Path(path), number, words, usual or {}) for number, words in enumerate(cells, 1)]
    seen: dict[Path, int] = {}
    for row in rows:
        if row.output is not None:
            place = row.output.resolve()
            if place in seen:
                both = f"rows {seen[place]} and {row.number}"
                raise BadInput(f"{path}: {both} write {row.output}; give each another")
            seen[place] = row.number
    return rows


def _row(path: Path, number: int, cells: dict[str, str], usual: Mapping[str, Any]) -> Row:
    words = {name.replace("-", "_"): text for name, text in cells.items()}
    output = words.pop("output")
    if not output:
        return Row(number, None, None, "names no output")
    try:
        given = Request.read(words, path.parent)
    except BadInput as error:
        return Row(number, path.parent / output, None, str(error))
    added = {name: value for name, value in usual.items() if not words.get(name)}
    return Row(number, path.parent / output, replace(given, **added))


def make(row: Row, pipelines: Pipelines, *, force: bool = False) -> Outcome:
    """Make the video of a row, unless it is there; what cannot be made is told in the outcome."""
    output = str(row.output or "")
    began = time.monotonic()
    try:
        if row.request is None or row.output is None:
            raise BadInput(row.problem)
        kind = format_of(row.output, row.request.format)
        row.request.check()
        check_apart(row.output, row.request.inputs)
        if row.output.exists() and not force:
            _check_made(row.output, row.request)
            return Outcome(row.number, output, "there")
        check_output(row.output, force=force)
        video = row.request.make(pipelines.of(row.request))
        video.save(row.output, force=force, format=kind, consent=row.request.consent)
    except (BadInput, OSError) as error:
        return Outcome(row.number, output, "failed", message=" ".join(str(error).split()))
    seconds = round(time.monotonic() - began, 2)
    return Outcome(row.number, output, "made", video.frames, seconds, video.note)


def _check_made(output: Path, request: Request) -> None:
    """Refuse an output that was not made as the row says.

    Raises:
        BadInput: what is other about it.
    """
    origin = read_origin(output)
    wrong = []
    for name, path in (
        ("photo", request.photo), ("sound", request.audio), ("drive", request.drive),
        ("motion", request.motion), ("words", request.words),
    ):  # fmt: skip
        found = None if path is None else hash_of(path)[1]
        if found != origin.hashes.get(name):
            wrong.append(name)
    asked = asdict(request)
    if asked["crop"] is None:
        del asked["crop"]  # found by the face
    told = origin.settings.items()
    wrong += [name for name, value in told if name in asked and asked[name] != value]
    if wrong:
        raise BadInput(f"{output}: exists, but with another {wrong[0]}; give --force to replace it")


def run(
    path: Path,
    pipelines: Pipelines,
    usual: Mapping[str, Any] | None = None,
    *,
    force: bool = False,
    ray: str | None = None,
) -> int:
    """Make the videos of a list; prints a line for each that fails, and how many there are.

    Args:
        path: of the list.
        pipelines: that draw them.
        usual: options for rows that do not name them.
        force: make again what is there.
        ray: address of a cluster that makes them (`data_prep.cluster`); None makes them here.

    Returns:
        how many failed.

    Raises:
        BadInput: a list that cannot be read.
    """
    rows = read_list(path, usual)
    report = Path(path).with_suffix(".report.csv")
    outcomes: list[Outcome] = []
    for outcome in _each(rows, pipelines, force, ray):
        outcomes.append(outcome)
        outcomes.sort(key=lambda one: one.row)
        write_report(report, outcomes)
    failed = [one for one in outcomes if one.status == "failed"]
    for one in failed:
        console.print(
            f"angie: row {one.row}: {one.message}", style="red", highlight=False, markup=False,
            soft_wrap=True,
        )  # fmt: skip
    made, there = (sum(one.status == what for one in outcomes) for what in ("made", "there"))
    print(f"{path}: {made} made, {there} there already, {len(failed)} failed; see {report}")
    return len(failed)


def _each(rows: list[Row], pipelines: Pipelines, force: bool, ray: str | None) -> Iterator[Outcome]:
    """What becomes of the rows, as it does."""
    with progress("videos", len(rows), "videos") as advance:
        if ray is None:
            for row in rows:
                yield make(row, pipelines, force=force)
                advance()
            return
        work = partial(_elsewhere, pipelines.device, pipelines.precision, force)
        for row, outcome in spread_on_ray(work, rows, ray):
            lost = Outcome(row.number, str(row.output), "failed", message="its process died")
            yield outcome or lost
            advance()


def _elsewhere(device: str, precision: str, force: bool, row: Row) -> Outcome:
    """Make the video of a row in another process, which keeps what it has loaded."""
    return make(row, _loaded(device, precision), force=force)


@cache
def _loaded(device: str, precision: str) -> Pipelines:
    return Pipelines(device, precision)


def write_report(path: Path, outcomes: Iterable[Outcome]) -> None:
    """Write what became of the rows, as CSV, whole or not at all."""
    names = [entry.name for entry in fields(Outcome)]
    with whole_file(path, force=True) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, names)
        writer.writeheader()
        writer.writerows(asdict(one) for one in outcomes)
