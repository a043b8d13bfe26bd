"""Rows of the table: ground truth, baselines, generators; each gives motion for every test clip."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from angie.bundle import Bundle
from angie.evaluation.space import RegionSpace, onsets_within
from angie.generators import family
from angie.generators.base import Family, GestureGenerator, resample
from angie.motion.clips import MotionClip
from angie.motion.windows import WINDOW
from data_prep.rates import FPS, FRAMES_PER_TOKEN
from mraa.motion import Motion, positive

FADE = 8
"""Frames in which one such piece becomes the next."""

STARTS = ("truth", "pose")
"""How a generator begins: with the beginning of the recorded motion, or with stillness."""

TRUE_REGIONS = "true regions"
"""Row of what the renderer draws from the regions of the recorded frames."""

REFERENCES = ("ground truth", "motionless", "mismatched", "nearest audio", TRUE_REGIONS)
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


@dataclass(frozen=True)
class System:
    """A generator of a bundle, which has a row of its own.

    Attributes:
        name: of the row.
        bundle: complete, as far as the generator needs it.
        generator: name of its family.
    """

    name: str
    bundle: Bundle
    generator: str

    @property
    def family(self) -> Family:
        """What is known of this kind of generator."""
        return family(self.generator)

    def load(self) -> GestureGenerator:
        """The generator."""
        return self.bundle.generator(self.generator)

    def knows(self, speaker: str) -> str | None:
        """A speaker's name, if the generator was trained on them."""
        return speaker if speaker in self.bundle.statistics().speakers else None


def systems(bundles: Mapping[str, Bundle], generator: str | None = None) -> list[System]:
    """The generators of bundles, or one of each, as rows.

    Args:
        bundles: by name; a generator's own is added where one bundle has several rows.
        generator: the only one wanted; None is all.

    Raises:
        BadInput: a bundle has no such generator, or one lacks a part.
    """
    found = []
    for name, bundle in bundles.items():
        wanted = [bundle.chosen(generator)] if generator else bundle.generators
        for own in wanted:
            for part in bundle.needed(own):
                bundle.path_of(part)
            found.append(System(f"{name} ({own})" if len(wanted) > 1 else name, bundle, own))
    return found


def row_names(folders: Sequence[Path]) -> list[str]:
    """Names of the rows of different folders: with as many of their parents as distinguish them."""
    places = [Path(folder).resolve().parts for folder in folders]
    names = [""] * len(places)
    for length in range(1, max(map(len, places)) + 1):
        longer = ["/".join(parts[-length:]) for parts in places]
        names = [name or new for name, new in zip(names, longer, strict=True)]
        taken = [*names, *REFERENCES]
        names = [name if taken.count(name) == 1 else "" for name in names]
    return [name or "/".join(parts) for name, parts in zip(names, places, strict=True)]


def perform(clip: MotionClip, motion: Motion) -> Performance:
    """Motion to the sound of a clip, both cut to the shorter of the two."""
    frames = min(motion.frames, clip.motion.frames)
    onsets = onsets_within(clip, frames)
    return Performance(clip.name, clip.speaker, motion[:frames], onsets, clip.motion[:frames])


def baselines(space: RegionSpace, seeds: Sequence[int]) -> list[Row]:
    """The rows that always stand there: ground truth and three baselines."""
    return [ground_truth(space), motionless(space), mismatched(space, seeds), nearest_audio(space)]


def ground_truth(space: RegionSpace) -> Row:
    """The motion that was recorded with the sound."""
    run = [perform(clip, clip.motion) for clip in space.test]
    return Row("ground truth", "The motion that was recorded with the sound.", [run])


def held(clip: MotionClip) -> Motion:
    """The first pose of a clip throughout."""
    return clip.motion.like(clip.motion[:1].vector().expand(clip.motion.frames, -1))


def resampled(space: RegionSpace, fps: int) -> Row:
    """The recorded motion at another rate and back, as what is generated at that rate comes out."""

    def through(motion: Motion) -> Motion:
        there = resample(motion, FPS, fps, smooth=True)
        return positive(resample(there, fps, FPS, motion.frames, smooth=True))

    about = f"The recorded motion at {fps} frames a second and back: what that rate alone costs."
    return Row(f"truth at {fps} fps", about, [[perform(c, through(c.motion)) for c in space.test]])


def motionless(space: RegionSpace) -> Row:
    """The first pose of each clip, held."""
    run = [perform(clip, held(clip)) for clip in space.test]
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
        "is only one test clip), cut to the shorter of the two.",
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
    system: System,
    generator: GestureGenerator,
    seeds: Sequence[int],
    start: str = "truth",
    greedy: bool = False,
) -> Row:
    """What a generator makes of the sound of each test clip, from its first pose.

    Args:
        space: the clips.
        system: of a bundle of this space.
        generator: its generator.
        seeds: one run each; without anything random there is one run.
        start: "truth" gives the generator the first window of the recorded motion, of which it
            takes what its paper's protocol does (ANGIE: the first code pair); "pose" begins with
            stillness, as for a photo.
        greedy: always the likeliest gesture, whatever the bundle's own sampling.
    """
    if start not in STARTS:
        raise ValueError(f"start is one of {', '.join(STARTS)}, not {start!r}")
    random = generator.random and not greedy
    runs = [
        [
            perform(
                clip,
                generator.generate(
                    clip.speech,
                    clip.motion[:1],
                    clip.motion.frames,
                    seed=seed,
                    speaker=system.knows(clip.speaker),
                    seed_motion=clip.motion[:WINDOW] if start == "truth" else None,
                    greedy=greedy or None,
                ),
            )
            for clip in space.test
        ]
        for seed in (seeds if random else seeds[:1])
    ]
    begin = "the beginning of its motion" if start == "truth" else "stillness"
    how = "sampled" if random else "greedy"
    return Row(
        system.name, f"{system.family.title}, {how}, from each clip's first pose and {begin}.", runs
    )
