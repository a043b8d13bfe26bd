"""PATS: the dataset's own table of intervals, and the source videos that a person still has."""

import csv
import re
import unicodedata
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from urllib.parse import parse_qs, urlparse

from data_prep.errors import BadInput
from data_prep.prepare.source import (
    EXTENSIONS,
    Outcome,
    Source,
    name_sources,
    placed,
    plain,
    videos_in,
)
from data_prep.table import number, read_table

MISSING = "pats_missing.csv"
MISSING_COLUMNS = (
    "interval_id",
    "speaker",
    "start_time",
    "end_time",
    "video_fn",
    "video_link",
    "reason",
)

_ORDER = [f"interval.{name}" for name in ("speaker", "file", "start", "id")]
_NEEDED = ("interval_id", "speaker", "start_time", "end_time")
_TIME = re.compile(
    r"(?:(?P<days>\d+) days? ?)?.*?(?:(?P<h>\d+):)?(?P<m>\d+):(?P<s>\d+(?:[.,]\d*)?)$"
)
_VIDEO_ID = re.compile(r"(?:[-_ ]|\[)([\w-]{11})\]?$")
"""The id that download tools put at the end of a name: `Title-ID` or `Title [ID]`."""


@dataclass(frozen=True)
class Interval:
    """A row of the table.

    Attributes:
        id: `interval_id`, unique among those of a speaker.
        speaker: PATS' name.
        start: seconds in the video.
        end: seconds in the video.
        file: `video_fn`.
        link: `video_link`.
    """

    id: str
    speaker: str
    start: float
    end: float
    file: str
    link: str


@dataclass(frozen=True)
class Missing:
    """An interval that the dataset lacks, and why."""

    interval: Interval
    reason: str


def read_time(text: str) -> float:
    """Seconds of a time such as 00:13:07.250000, 0 days 00:13:07.25, a date with it, or 787.25.

    Raises:
        ValueError: no time.
    """
    text = text.strip()
    match = None if text.startswith("-") else _TIME.fullmatch(text)
    if match is None:
        return number(text)
    hours = int(match["days"] or 0) * 24 + int(match["h"] or 0)
    return hours * 3600 + int(match["m"]) * 60 + number(match["s"])


def read_intervals(path: Path, speaker: str | None = None) -> tuple[list[Interval], list[Missing]]:
    """Read the table, `cmu_intervals_df.csv`.

    Args:
        path: the table; it may have more columns, in any order.
        speaker: whose rows to read, None for all.

    Returns:
        the intervals, and rows whose times make no sense.

    Raises:
        BadInput: not readable, a column missing, or no row of that speaker.
    """
    advice = "; give PATS' cmu_intervals_df.csv"
    rows = read_table(path, _NEEDED, advice, one_of=("video_fn", "video_link"))
    intervals: list[Interval] = []
    bad: list[Missing] = []
    for row in rows:
        if speaker in (None, row["speaker"]):
            interval, fault = _interval(row)
            if fault:
                bad.append(Missing(interval, fault))
            else:
                intervals.append(interval)
    if not intervals:
        known = ", ".join(sorted({row["speaker"] for row in rows})[:30]) or "none"
        raise BadInput(f"{path}: no interval of speaker {speaker or 'any'}; there are {known}")
    return intervals, bad


def _interval(row: dict[str, str]) -> tuple[Interval, str]:
    """A row, and what is wrong with it."""
    start = end = 0.0
    fault = ""
    try:
        start, end = read_time(row["start_time"]), read_time(row["end_time"])
        if not 0 <= start < end < float("inf"):
            fault = "the interval ends before it starts"
    except ValueError:
        fault = "the times cannot be read"
    texts = [row.get(name, "") for name in ("video_fn", "video_link")]
    return Interval(row["interval_id"], row["speaker"], start, end, *texts), fault


def pats_sources(
    intervals: Sequence[Interval], places: Iterable[Path]
) -> tuple[list[Source], list[Missing]]:
    """Find the videos of intervals among those that are there.

    A video is found by the stem of `video_fn`, whatever its ending and punctuation, or by the
    id in `video_link`, as the whole name or at its end.

    Args:
        intervals: of the table.
        places: videos, or folders that are searched through all their levels.

    Returns:
        a source for each video and speaker, ordered by their names, and what is missing.

    Raises:
        BadInput: a place that does not exist, or none of the videos is there.
    """
    videos = _index(places)
    found: dict[tuple[Path, str], list[Interval]] = defaultdict(list)
    missing: list[Missing] = []
    for interval in intervals:
        names = [_bare(_stem(interval.file)), *map(_bare, _link_ids(interval.link))]
        video = next((videos[name] for name in names if name and name in videos), None)
        if video is None:
            missing.append(Missing(interval, "no such video in the folder"))
        else:
            found[video, interval.speaker].append(interval)
    if not found:
        example = intervals[0].file or intervals[0].link
        raise BadInput(
            f"none of the {len(intervals)} intervals' videos is in the folder; the first is to be "
            f"named {_stem(example)!r}, with any ending"
        )
    sources = [
        Source(
            path,
            plain(speaker),
            "",
            tuple((i.id, i.start, i.end) for i in sorted(group, key=lambda i: (i.start, i.end))),
        )
        for (path, speaker), group in found.items()
    ]
    sources.sort(key=lambda source: (source.speaker, source.path.stem))
    return name_sources(sources), missing


def not_kept(intervals: Sequence[Interval], outcomes: Sequence[Outcome]) -> list[Missing]:
    """Intervals of found videos from which no clip was kept, with the reason."""
    by_id = {(plain(i.speaker), i.id, i.start): i for i in intervals}
    missing: list[Missing] = []
    for outcome in outcomes:
        middles = [clip.start + clip.n_frames / 50 for clip in outcome.clips]
        origin = outcome.info.start if outcome.info else 0.0
        reason = outcome.refused or (
            f"no clip kept ({', '.join(sorted(outcome.dropped)) or 'too short'})"
        )
        for id, start, end in outcome.source.intervals:
            kept = any(start <= middle + origin <= end for middle in middles)
            interval = by_id.get((outcome.source.speaker, id, start))
            if not kept and interval is not None:
                missing.append(Missing(interval, reason))
    return missing


def write_missing(path: Path, missing: Sequence[Missing]) -> None:
    """Write the list of missing intervals, ordered by speaker, video and time."""
    with Path(path).open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(MISSING_COLUMNS)
        for entry in sorted(missing, key=attrgetter(*_ORDER)):
            i = entry.interval
            times = (f"{i.start:.3f}", f"{i.end:.3f}")
            table.writerow((i.id, i.speaker, *times, i.file, i.link, entry.reason))


def read_missing(path: Path) -> list[Missing]:
    """Read what `write_missing` wrote."""
    rows = read_table(path, MISSING_COLUMNS)
    return [Missing(_interval(row)[0], row["reason"]) for row in rows]


def _stem(name: str) -> str:
    name = name.rsplit("/", 1)[-1].rsplit("\\", 1)[-1]
    path = Path(name)
    return path.stem if path.suffix.lower() in EXTENSIONS else name


def _bare(text: str) -> str:
    """Letters and digits only, in lower case; ids lose their dashes too."""
    return "".join(c for c in unicodedata.normalize("NFKC", text).casefold() if c.isalnum())


def _link_ids(link: str) -> list[str]:
    """Names that a download tool may have given to what is behind a link."""
    if not link:
        return []
    parts = urlparse(link)
    ids = parse_qs(parts.query).get("v", [])
    tail = _stem(parts.path.rstrip("/"))
    return [*ids, tail] if tail and tail != "watch" else ids


def _index(places: Iterable[Path]) -> dict[str, Path]:
    """Videos by the names that they may go by; the first of equal ones."""
    index: dict[str, Path] = {}
    ids: dict[str, Path] = {}
    for place in map(Path, places):
        if not place.exists():
            raise BadInput(f"{place}: no such file or folder; check the name")
        for video in videos_in(place) if place.is_dir() else [place]:
            index.setdefault(_bare(video.stem), placed(video))
            if match := _VIDEO_ID.search(video.stem):
                ids.setdefault(_bare(match[1]), placed(video))
    return {**ids, **index}
