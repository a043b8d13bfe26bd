"""Splits share no source where there are three, and lie a second apart where there are fewer."""

from collections import defaultdict
from dataclasses import replace

import pytest

from data_prep.dataset import Clip
from data_prep.prepare.split import split_clips


def clips_of(speaker: str, lengths: list[list[int]]) -> list[Clip]:
    """Clips that follow one another without a gap; a list of lengths for each source."""
    clips = []
    for source, frames in enumerate(lengths):
        start = 0
        for i, n in enumerate(frames):
            name = f"{speaker}{source}"
            clips.append(Clip(f"{name}_{i:02d}", speaker, "", name, start / 25, n))
            start += n
    return clips


def sources_of(clips: list[Clip]) -> dict[str, set[str]]:
    sources: dict[str, set[str]] = defaultdict(set)
    for clip in clips:
        sources[clip.split].add(clip.source)
    return sources


def share(clips: list[Clip], split: str) -> float:
    return sum(c.n_frames for c in clips if c.split == split) / sum(c.n_frames for c in clips)


@pytest.mark.parametrize("count", [3, 4, 5, 10, 40])
def test_no_source_is_shared_from_three_on(count: int) -> None:
    split = split_clips(clips_of("a", [[250] * 3] * count))
    sources = sources_of(split.clips)
    assert split.rules == {"a": "by source"} and not split.gaps
    assert len(sources["train"] | sources["val"] | sources["test"]) == count
    assert sum(len(own) for own in sources.values()) == count
    assert min(len(sources[name]) for name in ("train", "val", "test")) >= 1
    expected = {3: (1, 1), 4: (1, 1), 5: (1, 1), 10: (1, 1), 40: (4, 3)}[count]
    assert (len(sources["test"]), len(sources["val"])) == expected


def test_a_long_source_does_not_become_the_test() -> None:
    # 10 + 10 + 1: one source is unavoidable for testing, the short one is enough
    split = split_clips(clips_of("a", [[250], [250], [125]]))
    assert sources_of(split.clips)["test"] == {"a2"}
    # nineteen short ones and a giant: the test share stays near a tenth
    split = split_clips(clips_of("a", [[250]] * 19 + [[250] * 60]))
    assert 0.08 <= share(split.clips, "test") <= 0.12
    assert 0.05 <= share(split.clips, "val") <= 0.1
    assert "a19" in sources_of(split.clips)["train"]


def test_the_order_of_the_clips_does_not_matter() -> None:
    clips = clips_of("a", [[250] * 2] * 7) + clips_of("b", [[250] * 9, [120] * 9])
    here = {c.id: (c.split, c.n_frames) for c in split_clips(clips).clips}
    there = {c.id: (c.split, c.n_frames) for c in split_clips(clips[::-1]).clips}
    assert here == there


def test_sources_that_come_later_move_none() -> None:
    first = split_clips(clips_of("a", [[250]] * 10))
    before = {clip.source: clip.split for clip in first.clips}
    later = split_clips(clips_of("a", [[250]] * 40), before)
    assert {c.source: c.split for c in later.clips if c.source in before} == before
    assert {name: len(own) for name, own in sources_of(later.clips).items()} == {
        "train": 33,
        "val": 3,
        "test": 4,
    }


def test_one_source_is_divided_in_time_with_a_second_between() -> None:
    split = split_clips(clips_of("a", [[250] * 20]))
    parts = {name: [c for c in split.clips if c.split == name] for name in ("train", "val", "test")}
    # a tenth of 20 clips; 7 % of them is nearest to one clip
    assert [c.id for c in parts["test"]] == ["a0_18", "a0_19"]
    assert [c.id for c in parts["val"]] == ["a0_17"]
    assert [c.n_frames for c in parts["train"]] == [250] * 16 + [225]
    assert parts["val"][0].n_frames == 225
    assert split.gaps == {"a0": 2.0} and split.rules == {"a": "in time, 1.0 s apart"}


def test_a_clip_too_short_to_shorten_is_left_out() -> None:
    split = split_clips(clips_of("a", [[250, 110, 250]]))
    assert [(c.id, c.split, c.n_frames) for c in split.clips] == [
        ("a0_00", "train", 250),
        ("a0_02", "test", 250),
    ]
    assert split.gaps == {"a0": 4.4} and split.rules == {"a": "in time, 4.4 s apart"}
    # the only clip for training is kept, and the gap that could be made is told
    split = split_clips(clips_of("a", [[110, 250]]))
    assert [c.n_frames for c in split.clips] == [97, 250]
    assert split.rules == {"a": "in time, 0.5 s apart"}


def test_few_clips() -> None:
    clips = (
        clips_of("b", [[250], [250]]) + clips_of("c", [[250]]) + clips_of("d", [[250] * 3, [99]])
    )
    split = split_clips(clips)
    assert split.rules == {
        "b": "one source for testing, no validation",
        "c": "train only",
        "d": "in time, 1.0 s apart",
    }
    assert [c.id for c in split.clips if c.split == "test"] == ["b1_00", "d0_02"]
    assert {c.split for c in split.clips} == {"train", "test"}


def test_nobody_is_seen_in_two_splits_where_faces_are_told_apart_from_speakers() -> None:
    clips = [
        replace(clip, person=f"face{i % 5}")
        for speaker in ("ann", "bob")
        for i, clip in enumerate(clips_of(speaker, [[250]] * 10))
    ]
    split = split_clips(clips)
    faces = {name: {c.person for c in split.clips if c.split == name} for name in ("train", "test")}
    faces["val"] = {c.person for c in split.clips if c.split == "val"}
    assert sum(len(own) for own in faces.values()) == 5 == len(set.union(*faces.values()))
    assert {c.speaker for c in split.clips if c.split == "train"} == {"ann", "bob"}
    assert split.rules == {"ann": "by person", "bob": "by person"}
    before = {clip.source: clip.split for clip in split.clips}
    new = [Clip("new_00", "eve", "", "new", 0.0, 250, split.clips[0].person)]
    later = {c.id: c.split for c in split_clips([*clips, *new], before).clips}
    assert later["new_00"] == split.clips[0].split


def test_short_clips_are_not_lengthened_by_what_is_left_between() -> None:
    split = split_clips(clips_of("a", [[40, 250]]))
    assert [c.n_frames for c in split.clips] == [40, 250]
