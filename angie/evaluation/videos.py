"""Side-by-side videos: the recorded frames, then the rendered motion of each row."""

import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from angie.evaluation.images import rendered
from angie.evaluation.rows import Row
from angie.motion.clips import MotionClip
from angie.video import COMMENT
from data_prep.dataset import Clip, Dataset
from data_prep.media.video import VideoWriter
from data_prep.rates import FPS, IMAGE_SIZE, SAMPLE_RATE
from mraa.motion import Motion
from mraa.renderer import Renderer

STRIP = 24
"""Height in pixels of the strip with the rows' names."""

_AFTER = 0.35
"""Brightness of the last frame where a row's motion ends before the clip does."""


def in_turn(clips: Sequence[MotionClip], count: int) -> list[int]:
    """Numbers of `count` clips, speaker by speaker in turn."""
    seen: dict[str, int] = {}
    order = []
    for index, clip in enumerate(clips):
        turn = seen[clip.speaker] = seen.get(clip.speaker, -1) + 1
        order.append((turn, clip.speaker, index))
    return [index for _, _, index in sorted(order)[:count]]


def header(names: Sequence[str]) -> NDArray:
    """A strip (24, 256 n, 3) uint8 with the names of the columns."""
    strip = np.full((STRIP, IMAGE_SIZE * len(names), 3), 255, np.uint8)
    for column, name in enumerate(names):
        text = name.encode("ascii", "replace").decode()[:32]
        place = (IMAGE_SIZE * column + 6, 17)
        cv2.putText(
            strip, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.45, (30, 37, 48), 1, cv2.LINE_AA
        )
    return strip


def frames_of(
    renderer: Renderer, source: NDArray, pose: Motion, motion: Motion
) -> Iterator[NDArray]:
    """Frames (H, W, 3) uint8 of a motion; a still one is drawn once."""
    vector = motion.vector()
    if bool((vector == vector[0]).all()):
        still = next(iter(rendered(renderer, source, pose, motion[:1])))[0]
        yield from [still] * motion.frames
    else:
        for batch in rendered(renderer, source, pose, motion):
            yield from batch


def padded(frames: Iterator[NDArray], count: int) -> Iterator[NDArray]:
    """`count` frames, at least one being given; the last one goes on, darkened."""
    given = 0
    for frame in itertools.islice(frames, count):
        given += 1
        yield frame
    yield from [(frame * _AFTER).astype(np.uint8)] * (count - given)


def write_video(
    path: Path, dataset: Dataset, clip: Clip, columns: dict[str, Iterator[NDArray]]
) -> None:
    """Write one side-by-side video with the clip's sound: recorded frames, then `columns`.

    Args:
        path: the mp4 to write.
        dataset: holds the clip.
        clip: the clip.
        columns: frames (256, 256, 3) uint8 of each further column, as many as the clip has.
    """
    strip = header(["recorded", *columns])
    size = (strip.shape[1], IMAGE_SIZE + STRIP)
    sound = (dataset.sound(clip), SAMPLE_RATE)
    store = dataset.frames(clip)
    with VideoWriter(path, size, FPS, sound=sound, comment=COMMENT) as video:
        for index in range(len(store)):
            row = np.concatenate([store[index], *(next(c) for c in columns.values())], axis=1)
            video.write(np.concatenate([strip, row]))


def write_videos(
    folder: Path,
    dataset: Dataset,
    clips: Sequence[MotionClip],
    rows: Sequence[Row],
    renderer: Renderer,
    count: int,
) -> list[str]:
    """Write `count` side-by-side videos of the rows' first runs.

    `clips`: test clips, in the order of the rows' performances. `rows`: what is shown; the ground
    truth is drawn from its regions.

    Returns:
        names of the files.
    """
    stored = {clip.id: clip for clip in dataset.clips()}
    names = []
    for index in in_turn(clips, count):
        clip = clips[index]
        source = dataset.frames(stored[clip.name])[0]
        columns = {}
        for row in rows:
            label = "true regions" if row.name == "ground truth" else row.name
            motion = row.runs[0][index].motion
            frames = frames_of(renderer, source, clip.motion[:1], motion)
            columns[label] = padded(frames, clip.motion.frames)
        name = f"{clip.name}.mp4"
        write_video(folder / name, dataset, stored[clip.name], columns)
        names.append(name)
    return names
