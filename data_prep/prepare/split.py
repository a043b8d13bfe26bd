"""Training, validation and test clips that share no source, or lie apart in time."""

import hashlib
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from data_prep.dataset import Clip
from data_prep.prepare.source import MIN_FRAMES
from data_prep.rates import FPS

TEST_SHARE = 0.1
"""Part of the frames that is for testing (ANGIE, section 5: 90 / 10)."""

VAL_SHARE = 0.07
"""Part of the frames that is for choosing weights and settings."""

MIN_SOURCES = 3
"""Number of a speaker's sources from which on no source is shared between splits."""

MIN_CLIPS_FOR_VAL = 8
"""Clips of a source that is divided in time from which on some are for validation."""

GAP = FPS
"""Frames left unused between two splits of one source."""

SPLITS = ("train", "val", "test")

BY_SOURCE = "by source"
"""The rule for speakers with `MIN_SOURCES` sources."""

BY_PERSON = "by person"
"""The rule where people are told apart from speakers: nobody is seen in two splits."""


@dataclass(frozen=True)
class Split:
    """How clips were divided.

    Attributes:
        clips: with their splits, in the given order; shortened or left out where a gap is made.
        rules: for each speaker `BY_SOURCE`, `BY_PERSON`, "in time, ... s apart", "train only" for
            a single clip, or "one source for testing, no validation" for two of a single clip.
        gaps: seconds of each source that were left unused between splits.
    """

    clips: list[Clip]
    rules: dict[str, str]
    gaps: dict[str, float]


def split_clips(clips: Sequence[Clip], before: Mapping[str, str] | None = None) -> Split:
    """Divide clips into "train", "val" and "test", speaker by speaker, the same way every time.

    A speaker with at least `MIN_SOURCES` sources: each source is of one split, chosen in the
    order of the hashes of their names, so that nothing depends on the order of recording.
    With fewer, the last part in time of each source is for testing, before it lies
    validation if there are clips enough, and at least `GAP` frames between are left unused.
    Where people are told apart from speakers, and there are `MIN_SOURCES` of them, they are what
    is divided, as sources else are, over all speakers together.

    Args:
        clips: with any splits; they are not looked at.
        before: split of each source that was divided by source in an earlier run; it stays.
    """
    done: dict[str, Clip] = {}
    rules: dict[str, str] = {}
    seen = [clip for clip in clips if clip.person]
    if len({clip.person for clip in seen}) >= MIN_SOURCES:
        done.update((clip.id, clip) for clip in _by_source(seen, before or {}, "person"))
        rules.update((clip.speaker, BY_PERSON) for clip in seen)
    groups: dict[str, list[Clip]] = defaultdict(list)
    for clip in clips:
        if clip.id not in done:
            groups[clip.speaker].append(clip)
    for speaker, group in sorted(groups.items()):
        if len({clip.source for clip in group}) >= MIN_SOURCES:
            divided, rules[speaker] = _by_source(group, before or {}), BY_SOURCE
        else:
            divided, rules[speaker] = _in_time(group)
        done.update((clip.id, clip) for clip in divided)
    gaps: dict[str, float] = defaultdict(float)
    for clip in clips:
        lost = clip.n_frames - (done[clip.id].n_frames if clip.id in done else 0)
        if lost:
            gaps[clip.source] += lost / FPS
    return Split([done[c.id] for c in clips if c.id in done], rules, dict(gaps))


def _by_source(clips: list[Clip], before: Mapping[str, str], what: str = "source") -> list[Clip]:
    """Clips of which no two of one source, or of one person, are in different splits."""
    frames: dict[str, int] = defaultdict(int)
    of: dict[str, str] = {}
    for clip in clips:
        frames[getattr(clip, what)] += clip.n_frames
        if clip.source in before:
            of[getattr(clip, what)] = before[clip.source]
    free = sorted(
        (source for source in frames if source not in of),
        key=lambda name: hashlib.sha256(name.encode()).digest(),
    )
    total = sum(frames.values())
    # The smaller splits first: each takes at least one source and leaves some for the others.
    for split, share, others in (("test", TEST_SHARE, 2), ("val", VAL_SHARE, 1)):
        taken = sum(frames[source] for source, its in of.items() if its == split)
        missing = sum(s not in of.values() for s in SPLITS[:others])
        chosen = _fill(free, frames, share * total - taken, taken == 0, missing)
        of.update((source, split) for source in chosen)
        free = [source for source in free if source not in chosen]
    of.update((source, "train") for source in free)
    return [replace(clip, split=of[getattr(clip, what)]) for clip in clips]


def _fill(
    free: list[str], frames: Mapping[str, int], goal: float, must: bool, leave: int
) -> list[str]:
    """Sources for a split: in their order what fits, then the smallest if that comes nearer.

    Args:
        free: to choose from.
        frames: of each source.
        goal: frames that are wanted.
        must: whether at least one has to be chosen.
        leave: number of sources that must be left.
    """
    chosen: list[str] = []
    for source in free:
        if len(free) - len(chosen) > leave and frames[source] <= goal:
            chosen.append(source)
            goal -= frames[source]
    rest = [source for source in free if source not in chosen]
    if len(rest) > leave:
        smallest = min(rest, key=lambda source: frames[source])
        if frames[smallest] < 2 * goal or (must and not chosen):
            chosen.append(smallest)
    return chosen


def _in_time(clips: list[Clip]) -> tuple[list[Clip], str]:
    sources: dict[str, list[Clip]] = defaultdict(list)
    for clip in sorted(clips, key=lambda clip: (clip.source, clip.start)):
        sources[clip.source].append(clip)
    if len(clips) == 1:
        return [replace(clips[0], split="train")], "train only"
    if all(len(group) == 1 for group in sources.values()):
        *first, last = (group[0] for group in sources.values())
        return [replace(c, split="train") for c in first] + [replace(last, split="test")], (
            "one source for testing, no validation"
        )
    divided: list[Clip] = []
    gaps: list[int] = []
    for group in sources.values():
        parts = _parts(group)
        for number, part in enumerate(parts):
            if part and number + 1 < len(parts):
                part, gap = _apart(part, parts[number + 1][0])
                gaps.append(gap)
            divided += part
    return divided, f"in time, {min(gaps) / FPS:.1f} s apart"


def _parts(group: list[Clip]) -> list[list[Clip]]:
    """The splits of one source in order of time, none of them empty."""
    total = sum(clip.n_frames for clip in group)
    if len(group) == 1:
        return [[replace(group[0], split="train")]]
    rest = list(group)
    parts: list[list[Clip]] = []
    wanted = [("test", TEST_SHARE)]
    if len(group) >= MIN_CLIPS_FOR_VAL:
        wanted.append(("val", VAL_SHARE))
    for split, share in wanted:
        part = [rest.pop()]
        while len(rest) > 2 and _frames(part) + rest[-1].n_frames / 2 <= share * total:
            part.append(rest.pop())
        parts.insert(0, [replace(clip, split=split) for clip in reversed(part)])
    return [[replace(clip, split="train") for clip in rest], *parts]


def _frames(clips: list[Clip]) -> int:
    return sum(clip.n_frames for clip in clips)


def _apart(part: list[Clip], following: Clip) -> tuple[list[Clip], int]:
    """Shorten, or leave out, the last clip before another split; the gap in frames."""
    *first, last = part
    gap = round((following.start - last.start) * FPS) - last.n_frames
    missing = max(GAP - gap, 0)
    least = min(MIN_FRAMES, last.n_frames)
    if last.n_frames - missing < least:
        if first:
            return first, gap + last.n_frames
        missing = last.n_frames - least  # all there is: as far apart as can be
    kept = replace(last, n_frames=last.n_frames - missing)
    return [*first, kept], gap + missing
