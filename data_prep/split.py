"""Training and test clips."""

import hashlib
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace

from data_prep.dataset import Clip

TEST_SHARE = 0.1
"""Part of the frames that is for testing (ANGIE, section 5: 90 / 10)."""

MIN_SOURCES = 3
"""Sources of a speaker from which on training and test clips share none."""


def split_clips(clips: Sequence[Clip]) -> tuple[list[Clip], dict[str, str]]:
    """Divide clips into "train" and "test", speaker by speaker, the same way every time.

    With at least `MIN_SOURCES` sources whole sources are set aside for testing. With fewer,
    the last clips in time are; so both splits know the speaker wherever there are two clips.

    Returns:
        the clips with their splits, in the given order, and for each speaker how they were
        divided: "by source", "in time", or "train only" for a single clip.
    """
    groups: dict[str, list[Clip]] = defaultdict(list)
    for clip in clips:
        groups[clip.speaker].append(clip)
    test: set[str] = set()
    rules: dict[str, str] = {}
    for speaker, group in sorted(groups.items()):
        if len({clip.source for clip in group}) >= MIN_SOURCES:
            chosen, rules[speaker] = _by_source(group), "by source"
        elif len(group) > 1:
            chosen, rules[speaker] = _in_time(group), "in time"
        else:
            chosen, rules[speaker] = [], "train only"
        test.update(clip.id for clip in chosen)
    return [replace(c, split="test" if c.id in test else "train") for c in clips], rules


def _by_source(clips: list[Clip]) -> list[Clip]:
    frames: dict[str, int] = defaultdict(int)
    for clip in clips:
        frames[clip.source] += clip.n_frames
    goal = TEST_SHARE * sum(frames.values())
    chosen: list[str] = []
    taken = 0
    # The hash of the name shuffles: the order of recording must not decide.
    for source in sorted(frames, key=lambda name: hashlib.sha256(name.encode()).digest()):
        if not chosen or (taken + frames[source] / 2 <= goal and len(chosen) + 1 < len(frames)):
            chosen.append(source)
            taken += frames[source]
    return [clip for clip in clips if clip.source in chosen]


def _in_time(clips: list[Clip]) -> list[Clip]:
    ordered = sorted(clips, key=lambda clip: (clip.source, clip.start))
    return ordered[-max(1, round(TEST_SHARE * len(ordered))) :]
