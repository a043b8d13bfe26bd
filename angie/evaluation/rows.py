"""Rows of the table: ground truth, baselines, generators; each gives motion for every test clip."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from angie.bundle import Bundle
from angie.evaluation.space import RegionSpace, onsets_within
from angie.generators import family
from angie.motion.clips import MotionClip
from data_prep.rates import FRAMES_PER_TOKEN
from mraa.motion import Motion, positive

WINDOW = 96
"""Frames of a piece of the nearest sound: a training window of ANGIE."""

FADE = 8
"""Frames in which one such piece becomes the next."""

STARTS = ("truth", "pose")
"""How a generator begins: with the first code pair of the truth, or with those of stillness."""

REFERENCES = ("ground truth", "motionless", "mismatched", "nearest audio")
"""Names of the rows that always stand there."""


@dataclass(frozen=True)
class Performance:
    """Motion to the sound of a clip.

    Attributes:
        clip: name of the clip.
        speaker: name of the speaker; None for one that the dataset does not know.
        motion: T frames.
        onsets: (n,) onsets of the sound within the T frames, seconds.
        truth: what was recorded with that sound, the same T frames; None when unknown.
    """

    clip: str
    speaker: str | None
    motion: Motion
    onsets: NDArray
    truth: Motion | None


@dataclass(frozen=True)
class Row:
    """One row of the table.

    Attributes:
        name: as the table has it.
        about: where the motion comes from, one sentence.
        runs: performances of every clip for every seed; one run where nothing is random.
    """

    name: str
    about: str
    runs: list[list[Performance]]


def perform(clip: MotionClip, motion: Motion) -> Performance:
    """Motion to the sound of a clip, both cut to the shorter of the two."""
    frames = min(motion.frames, clip.motion.frames)
    onsets = onsets_within(clip, frames)
    return Performance(clip.name, clip.speaker, motion[:frames], onsets, clip.motion[:frames])


def ground_truth(space: RegionSpace) -> Row:
    """The motion that was recorded with the sound."""
    run = [perform(clip, clip.motion) for clip in space.test]
    return Row("ground truth", "The motion that was recorded with the sound.", [run])


def motionless(space: RegionSpace) -> Row:
    """The first pose of each clip, held."""
    run = []
    for clip in space.test:
        vector = clip.motion[:1].vector().expand(clip.motion.frames, -1)
        run.append(perform(clip, clip.motion.like(vector)))
    return Row("motionless", "The first pose of each clip, held.", [run])


def mismatched(space: RegionSpace, seeds: Sequence[int]) -> Row:
    """Real motion of the same speaker from another clip."""
    runs = []
    for seed in seeds:
        donors = _donors(space, seed)
        runs.append(
            [perform(clip, donor.motion) for clip, donor in zip(space.test, donors, strict=True)]
        )
    return Row(
        "mismatched",
        "Real motion of the same speaker from another test clip (of a training clip where there "
        "is one test clip alone), cut to the shorter of the two.",
        runs,
    )


def _donors(space: RegionSpace, seed: int) -> list[MotionClip]:
    """For each test clip another clip: a seeded derangement of each speaker's test clips."""
    rng = np.random.default_rng(seed)
    chosen: dict[str, MotionClip] = {}
    for speaker in sorted({clip.speaker for clip in space.test}):
        own = [clip for clip in space.test if clip.speaker == speaker]
        if len(own) == 1:
            other = [clip for clip in space.train if clip.speaker == speaker] or space.train
            chosen[own[0].name] = other[int(rng.integers(len(other)))]
            continue
        order = rng.permutation(len(own))
        step = int(rng.integers(1, len(own)))
        for here, there in zip(order, np.roll(order, step), strict=True):
            chosen[own[here].name] = own[there]
    return [chosen[clip.name] for clip in space.test]


def nearest_audio(space: RegionSpace) -> Row:
    """Training motion whose sound is nearest, piece by piece."""
    run = [perform(clip, _retrieve(clip, space)) for clip in space.test]
    return Row(
        "nearest audio",
        f"For each {WINDOW} frames of the sound the motion of the same speaker's training piece "
        "with the nearest standardised MFCC (mean square, every 8th frame a candidate), as "
        "displacement from the mean pose of the training clip, added to the first pose; joined "
        f"by linear fades of {FADE} frames.",
        [run],
    )


def _sound(clip: MotionClip, space: RegionSpace) -> NDArray:
    """Standardised cepstra (T, 12) of each frame: the mean of its own four."""
    mfcc = torch.as_tensor(clip.speech["mfcc"][: clip.motion.frames])
    middle = mfcc.shape[1] // 2
    own = space.statistics.standard_mfcc(mfcc)[:, middle - 2 : middle + 2]
    return own.mean(1).numpy()


def _retrieve(clip: MotionClip, space: RegionSpace) -> Motion:
    """Motion of the nearest training sound for a whole clip, as long as the clip."""
    shelf = [other for other in space.train if other.speaker == clip.speaker] or space.train
    sounds = [_sound(other, space) for other in shelf]
    wanted, frames = _sound(clip, space), clip.motion.frames
    start = clip.motion[:1].vector()
    total = torch.zeros(frames, start.shape[1])
    weight = torch.zeros(frames, 1)
    first = 0
    while True:
        piece = wanted[first : first + WINDOW]
        found = _nearest(piece, shelf, sounds)
        ramp = torch.ones(len(found), 1)
        if first:
            ramp[:FADE, 0] = torch.arange(1, FADE + 1) / (FADE + 1)
        last = first + len(found)
        if last < frames:
            ramp[-FADE:, 0] = torch.arange(FADE, 0, -1) / (FADE + 1)
        total[first:last] += found * ramp
        weight[first:last] += ramp
        if last >= frames:
            return positive(clip.motion.like(start + total / weight))
        first = last - FADE


def _nearest(piece: NDArray, shelf: list[MotionClip], sounds: list[NDArray]) -> torch.Tensor:
    """Displacement (n, 5K) from its clip's mean pose, of the sound nearest to a piece (n, 12).

    Where all training clips are shorter than the piece, n is the length of the longest.
    """
    size = min(len(piece), max(len(sound) for sound in sounds))
    best, place = np.inf, (0, 0)
    for index, sound in enumerate(sounds):
        if len(sound) < size:
            continue
        view = np.lib.stride_tricks.sliding_window_view(sound, size, axis=0)[::FRAMES_PER_TOKEN]
        apart = ((view - piece[:size].T) ** 2).mean(axis=(1, 2))
        if apart.min() < best:
            best, place = float(apart.min()), (index, int(apart.argmin()) * FRAMES_PER_TOKEN)
    index, first = place
    vector = shelf[index].motion.vector()
    return vector[first : first + size] - vector.mean(0)


def generated(
    space: RegionSpace,
    bundle: Bundle,
    name: str,
    seeds: Sequence[int],
    start: str = "truth",
    greedy: bool = False,
    generator_name: str | None = None,
) -> Row:
    """What a bundle's generator makes of the sound of each test clip, from its first pose.

    Args:
        space: the clips.
        bundle: a complete bundle of this space.
        name: of the row.
        seeds: one run each; a greedy generator gives one run.
        start: "truth" begins with the first code pair of the recorded motion (Bailando's and the
            paper's protocol), "pose" with the codes of stillness, as for a photo.
        greedy: always the likeliest gesture, whatever the bundle's own sampling.
        generator_name: which generator of the bundle; None is its default.
    """
    if start not in STARTS:
        raise ValueError(f"start is one of {', '.join(STARTS)}, not {start!r}")
    generator, speakers = bundle.generator(generator_name), bundle.statistics().speakers
    runs = []
    for seed in seeds if generator.random and not greedy else seeds[:1]:
        run = []
        for clip in space.test:
            motion = generator.generate(
                clip.speech,
                clip.motion[:1],
                clip.motion.frames,
                seed=seed,
                speaker=clip.speaker if clip.speaker in speakers else None,
                seed_motion=clip.motion if start == "truth" else None,
                greedy=greedy or None,
            )
            run.append(perform(clip, motion))
        runs.append(run)
    begin = "the beginning of its motion" if start == "truth" else "stillness"
    how = "drawn at random" if generator.random and not greedy else "the likeliest"
    title = family(bundle.chosen(generator_name)).title
    return Row(name, f"{title}, from each clip's first pose and {begin}; gestures {how}.", runs)
