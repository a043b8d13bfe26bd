"""What a run of `angie prepare` made, in numbers and in a few lines."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from data_prep.dataset import Clip
from data_prep.prepare.pats import MISSING, Missing
from data_prep.prepare.record import Record
from data_prep.prepare.split import SPLITS, Split
from data_prep.rates import FPS, IMAGE_SIZE

REPORT = "report.html"
GAP_REASON = "left unused between splits"
LEFT_OVER = "too short for a clip, or past the end of the sound"
OUTSIDE = "outside of the intervals"

SMALL = 0.75
"""Part of the frames' size below which a crop is reported as small."""

MUCH_FILLED = 0.15
"""Part of a crop outside the picture above which this is reported."""

NEGLIGIBLE = 0.05
"""Seconds left over by rounding of durations; not worth reporting."""

_MOST_LINES = 20


@dataclass(frozen=True)
class Summary:
    """What `prepare` made.

    Attributes:
        path: the dataset.
        records: of all its sources, in order of their names.
        split: how the clips were divided.
        doubles: files that hold the same video as another one, and that one.
        missing: intervals of PATS that the dataset lacks, None without such a table.
        before: split of each clip in the dataset that was added to.
        done_before: sources of this run that an earlier run had finished.
    """

    path: Path
    records: tuple[Record, ...]
    split: Split
    doubles: tuple[tuple[Path, Path], ...] = ()
    missing: tuple[Missing, ...] | None = None
    before: Mapping[str, str] = field(default_factory=dict)
    done_before: int = 0

    @property
    def clips(self) -> list[Clip]:
        """All that were kept, with their splits."""
        return self.split.clips

    @property
    def refused(self) -> list[tuple[Path, str]]:
        """Videos of which nothing was kept, with the reason."""
        return [
            (r.outcome.source.path, r.outcome.refused)
            for r in self.records
            if r.outcome.refused is not None
        ]

    @property
    def moved(self) -> int:
        """Clips that were in the dataset before and are of another split now."""
        return sum(self.before.get(clip.id, clip.split) != clip.split for clip in self.clips)

    @cached_property
    def dropped(self) -> dict[str, float]:
        """Seconds dropped, by reason, most first."""
        total: Counter[str] = Counter()
        for record in self.records:
            for reason, seconds in self.dropped_of(record).items():
                total[reason] += seconds  # type: ignore[assignment]
        return dict(sorted(total.items(), key=lambda item: (-item[1], item[0])))

    def dropped_of(self, record: Record) -> dict[str, float]:
        """Seconds of a source that were dropped, by reason; with what is kept they are its all."""
        outcome = record.outcome
        dropped = {brief(reason): float(s) for reason, s in sorted(outcome.dropped.items())}
        if gap := self.split.gaps.get(record.name):
            dropped[GAP_REASON] = gap
        given = outcome.info.duration if outcome.info else 0.0
        rest = given - sum(dropped.values()) - seconds_of(self.clips_of(record))
        if rest > NEGLIGIBLE:
            reason = OUTSIDE if outcome.source.intervals else LEFT_OVER
            if outcome.refused is not None:
                reason = brief(outcome.refused)
            dropped[reason] = dropped.get(reason, 0.0) + rest
        return {reason: round(seconds, 2) for reason, seconds in dropped.items()}

    def clips_of(self, record: Record) -> list[Clip]:
        """Clips of a source, with their splits."""
        return self._by_source.get(record.name, [])

    @cached_property
    def _by_source(self) -> dict[str, list[Clip]]:
        groups: dict[str, list[Clip]] = {}
        for clip in self.clips:
            groups.setdefault(clip.source, []).append(clip)
        return groups

    @cached_property
    def warnings(self) -> list[str]:
        """What a person should know of the dataset, one line each."""
        lines = [f"{double.name}: the same video as {first.name}" for double, first in self.doubles]
        for record in self.records:
            name = record.outcome.source.path.name
            lines += [f"{name}: {warning}" for warning in (*record.warnings, *_soft(record))]
        for speaker, rule in self.split.rules.items():
            own = {clip.split for clip in self.clips if clip.speaker == speaker}
            for split in [name for name in SPLITS if name not in own]:
                lines.append(f"{speaker}: no clip for {split} ({rule})")
        return lines

    def __str__(self) -> str:
        """A few lines for a person."""
        lines = [f"{self.path}: {counted(len(self.clips), 'clip')}, {minutes(self.clips)}"]
        if self.done_before:
            lines[0] += f"; {self.done_before} of the videos done before"
        for speaker, rule in self.split.rules.items():
            own = [clip for clip in self.clips if clip.speaker == speaker]
            parts = [
                f"{split} {sum(c.split == split for c in own)}"
                for split in SPLITS
                if any(c.split == split for c in own)
            ]
            lines.append(
                f"  {speaker}: {counted(len(own), 'clip')}, {minutes(own)}; "
                f"{', '.join(parts)} ({rule})"
            )
        lines += [f"  dropped {s:.1f} s: {r}" for r, s in self.dropped.items() if s >= NEGLIGIBLE]
        lines += _shortened([f"  refused {path}: {reason}" for path, reason in self.refused])
        lines += _shortened([f"  warning: {line}" for line in self.warnings])
        if self.moved:
            lines.append(
                f"  warning: {self.moved} clips are of another split than before; what was "
                "trained on the dataset must not be tested on it"
            )
        if self.missing:
            videos = {m.interval.file or m.interval.link for m in self.missing}
            lines.append(
                f"  missing {len(self.missing)} intervals of {len(videos)} videos; "
                f"they are listed in {self.path / MISSING}"
            )
        lines.append(f"  look at {self.path / REPORT}")
        return "\n".join(lines)


def _soft(record: Record) -> list[str]:
    """What makes the pictures of a source worse than others."""
    used = [s for s in record.outcome.spans if s.reason is None and s.crop is not None]
    sizes = [span.crop.size for span in used if span.crop is not None]
    if record.outcome.refused is not None or not used:
        return []
    lines = []
    if min(sizes) < SMALL * IMAGE_SIZE:
        lines.append(f"a crop of {min(sizes)} pixels is enlarged to {IMAGE_SIZE} and looks soft")
    filled = max(span.filled for span in used)
    if filled > MUCH_FILLED:
        lines.append(f"{filled:.0%} of a crop lies outside the picture and repeats its edge")
    return lines


def brief(reason: str) -> str:
    """The part of a reason that videos have in common."""
    return re.split(r"[;(]", reason)[0].strip() or reason


def seconds_of(clips: Sequence[Clip]) -> float:
    """Duration of clips together."""
    return sum(clip.n_frames for clip in clips) / FPS


def counted(count: int, name: str) -> str:
    """How many there are: "1 clip", "2 clips"."""
    return f"{count} {name}{'' if count == 1 else 's'}"


def minutes(clips: Sequence[Clip]) -> str:
    """Duration of clips together, for a person."""
    return f"{seconds_of(clips) / 60:.1f} min"


def _shortened(lines: list[str]) -> list[str]:
    more = len(lines) - _MOST_LINES
    return lines if more <= 0 else [*lines[:_MOST_LINES], f"  and {more} more, see {REPORT}"]
