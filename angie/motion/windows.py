"""Training windows: 96 frames of motion and the sound that goes with them, every 32 frames.

Long sequences in overlapping windows that fade into one another.
"""

import math
from collections.abc import Callable, Iterator, Sequence

import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import Dataset

from angie.motion.clips import MotionClip, begun_later
from angie.motion.statistics import MotionStatistics
from data_prep.errors import BadInput
from data_prep.progress import progress
from data_prep.rates import FRAMES_PER_TOKEN

WINDOW = 96
"""Frames of a training window (ANGIE, section 4)."""


WINDOW_TOKENS = WINDOW // FRAMES_PER_TOKEN
"""Codes of a window."""


STRIDE = 32
"""Frames from one training window to the next (ANGIE, section 4)."""


def check_stride(stride: int, step: int = 1) -> None:
    """Refuse a stride of training windows.

    Args:
        stride: frames.
        step: 1, or 8 where windows begin on the tokens of the sound.

    Raises:
        ValueError: not a positive multiple of `step`.
    """
    if stride < 1 or stride % step:
        wanted = f"a multiple of {step} frames" if step > 1 else "at least one frame"
        raise ValueError(f"stride is {wanted}, not {stride}")


def other_grids(
    clips: Sequence[MotionClip], sound: Callable[[str], NDArray], grids: int, feature: str = "onset"
) -> list[MotionClip]:
    """Clips on other grids of tokens than the one that begins with them.

    Args:
        clips: as long as a window.
        sound: gives a clip's sound (N,), float32 at 16 kHz, by its name.
        grids: 1, 2, 4 or 8, the first one among them.
        feature: of the tokens, computed anew.

    Returns:
        the clips begun 8 / grids frames later, twice as much later, and so on below 8, where
        they still are as long as a window.
    """
    starts = range(FRAMES_PER_TOKEN // grids, FRAMES_PER_TOKEN, FRAMES_PER_TOKEN // grids)
    if not starts:
        return []
    made = []
    with progress("grids of tokens", len(clips), "clips") as advance:
        for clip in clips:
            samples = sound(clip.name)
            fitting = [first for first in starts if clip.motion.frames - first >= WINDOW]
            made += [begun_later(clip, samples, first, feature) for first in fitting]
            advance()
    return made


class MotionWindows(Dataset[dict[str, Tensor]]):
    """Windows of clips, each with one leading frame, as dictionaries of tensors.

    Items hold the requested `parts`:
        poses: (97, 5K) absolute motion vectors; row 0 is the frame before the window. At the
            first frame of a clip it repeats that frame, so the first delta is zero.
        onset: (12, 426) standardised onset features of the window's tokens, or another feature
            of tokens, `sound`.
        mfcc: (96, 28, 12) standardised MFCC windows of its frames.
        speaker: () int64, place of the clip's speaker in the statistics' speakers.
    and one row of every tensor in `rows`. Windows with onsets begin on whole tokens.

    Args:
        clips: clips; those shorter than a window give none.
        statistics: for standardising.
        parts: names of the parts an item has.
        frames: frames T of a window, a multiple of 8.
        stride: frames from window to window; a multiple of 8 if onsets are among the parts.
        rows: tensors (number of windows, ...) with something precomputed for every window.
        sound: name of the feature of tokens, see `data_prep.speech.features.SOUND_SIZES`.

    Raises:
        BadInput: no clip is as long as a window.
    """

    def __init__(
        self,
        clips: Sequence[MotionClip],
        statistics: MotionStatistics,
        parts: Sequence[str] = ("poses",),
        frames: int = WINDOW,
        stride: int = STRIDE,
        rows: dict[str, Tensor] | None = None,
        sound: str = "onset",
    ) -> None:
        if frames % FRAMES_PER_TOKEN or ("onset" in parts and stride % FRAMES_PER_TOKEN):
            raise ValueError(f"windows end, and with onsets begin, on tokens: {frames}, {stride}")
        self.clips, self.statistics, self.parts = clips, statistics, tuple(parts)
        self.frames, self.stride, self.rows, self.sound = frames, stride, rows or {}, sound
        self.places = [
            (index, first)
            for index, clip in enumerate(clips)
            for first in range(0, clip.motion.frames - frames + 1, stride)
        ]
        if not self.places:
            raise BadInput(f"no clip has {frames} frames; prepare longer videos")

    def __len__(self) -> int:
        """Number of windows."""
        return len(self.places)

    def __getitem__(self, index: int) -> dict[str, Tensor]:
        """One window."""
        place, first = self.places[index]
        clip = self.clips[place]
        item = {name: getattr(self, f"_{name}")(clip, first) for name in self.parts}
        return item | {name: rows[index] for name, rows in self.rows.items()}

    def choose(self, parts: Sequence[str], **rows: Tensor) -> "MotionWindows":
        """The same windows with other parts and other precomputed rows."""
        chosen = MotionWindows(
            self.clips, self.statistics, parts, self.frames, self.stride, dict(rows), self.sound
        )
        chosen.places = self.places
        return chosen

    def chosen(self, indices: Sequence[int]) -> "MotionWindows":
        """Some of the windows, with their parts and rows."""
        fewer = self.choose(self.parts)
        fewer.places = [self.places[i] for i in indices]
        fewer.rows = {name: rows[list(indices)] for name, rows in self.rows.items()}
        return fewer

    def _poses(self, clip: MotionClip, first: int) -> Tensor:
        motion = clip.motion[max(first - 1, 0) : first + self.frames].vector()
        return motion if first else torch.cat([motion[:1], motion])

    def _onset(self, clip: MotionClip, first: int) -> Tensor:
        token, tokens = first // FRAMES_PER_TOKEN, self.frames // FRAMES_PER_TOKEN
        rows = torch.as_tensor(clip.speech[self.sound][token : token + tokens])
        return self.statistics.standard_sound(self.sound, rows)

    def _speaker(self, clip: MotionClip, first: int) -> Tensor:
        return torch.tensor(self.statistics.place_of(clip.speaker))

    def _mfcc(self, clip: MotionClip, first: int) -> Tensor:
        mfcc = torch.as_tensor(clip.speech["mfcc"][first : first + self.frames])
        return self.statistics.standard_mfcc(mfcc)

    def stack(self, part: str, first: int, last: int) -> Tensor:
        """One part of the windows [first, last), as far as there are any, stacked."""
        last = min(last, len(self))
        if part in self.rows:
            return self.rows[part][first:last]
        compute = getattr(self, f"_{part}")
        places = self.places[first:last]
        return torch.stack([compute(self.clips[index], frame) for index, frame in places])

    def groups(self, *parts: str, at_once: int = 64) -> Iterator[dict[str, Tensor]]:
        """Some parts of all windows, stacked, `at_once` windows at a time."""
        for first in range(0, len(self), at_once):
            yield {part: self.stack(part, first, first + at_once) for part in parts}


BLENDS = ("linear", "hann", "ahead")
"""How windows become one sequence.

"linear": windows every half window, in the middles of whose overlaps one becomes the next.
"hann": windows every quarter, weighted by a Hann window. The sums of the weights and of their
squares are then the same at every frame, so that no place of a window shows in the result, at
twice as many windows. Near both ends of the sequence fewer windows meet.
"ahead": for sound as it comes. Windows every token, each ending a token after the one that it is
taken for; in a token the window before fades into its own, so that no frame depends on more than
the token after its own, nor on more than what a window holds before. Six times as many windows.
"""


FADE = 24
"""Frames in which, under "linear", motion goes from one window to the next.

Where two windows are averaged motion loses what they do not share, and slows down; where one
becomes the other too fast, what sets them apart moves who is still. Here the two weigh the same.
"""


def window_starts(length: int, window: int, hop: int) -> list[int]:
    """First positions of windows that cover `length`; the last one ends exactly there.

    Raises:
        ValueError: hop outside [1, window], or nothing to cover.
    """
    if length < 1 or not 1 <= hop <= window:
        raise ValueError(f"cannot cover {length} with windows of {window} every {hop}")
    if length <= window:
        return [0]
    starts = list(range(0, length - window, hop))
    return [*starts, length - window]


def cross_fade(
    length: int,
    window: int,
    compute: Callable[..., Tensor],
    blend: str = "linear",
    at_once: int = 32,
    fade: int = FADE,
) -> Tensor:
    """Compute windows in groups and blend them, see `BLENDS`.

    Weights are divided by their sum, so windows that agree are reproduced exactly. Memory beside
    the result does not grow with the length.

    Args:
        length: frames of the whole sequence, T.
        window: frames of a window; a shorter sequence is one shorter window.
        compute: from n first frames to the windows' values (n, window, C); under "ahead", where
            windows at the ends are shorter, their size is the second argument.
        blend: one of `BLENDS`.
        at_once: most windows in one call of `compute`.
        fade: frames of a linear ramp, in the middle of the overlap.

    Returns:
        (T, C) blended values.

    Raises:
        ValueError: another blend, or nothing to cover.
    """
    if blend not in BLENDS:
        raise ValueError(f"blend is one of {', '.join(BLENDS)}, not {blend!r}")
    if blend == "ahead":
        return _ahead(length, window, compute, at_once)
    hop = window // (2 if blend == "linear" else 4)
    window = min(window, length)
    starts = window_starts(length, window, min(hop, window))
    place = torch.arange(window, dtype=torch.float32)
    hann = torch.sin(math.pi * (place + 0.5) / window).square()  # sampled between its zeros
    total, weight = None, torch.zeros(length, 1)
    for begin in range(0, len(starts), at_once):
        group = starts[begin : begin + at_once]
        values = compute(group).float().cpu()
        if total is None:
            total = torch.zeros(length, values.shape[-1])
        for index, (first, value) in enumerate(zip(group, values, strict=True), begin):
            part = hann if blend == "hann" else _faded(starts, index, place, fade)
            total[first : first + window] += value * part[:, None]
            weight[first : first + window] += part[:, None]
    assert total is not None  # window_starts refuses an empty sequence
    return total / weight


def _ahead(length: int, window: int, compute: Callable[..., Tensor], at_once: int) -> Tensor:
    """Values (T, C) of windows that end a token after the one they are taken for."""
    step = FRAMES_PER_TOKEN
    ends = [first + 2 * step for first in range(0, length, step)]
    spans = [(max(0, end - window), min(end, length)) for end in ends]
    values: dict[int, Tensor] = {}
    made: list[Tensor] = []
    for number, (begin, end) in enumerate(spans):
        if number not in values:  # windows of one size are computed together
            size = end - begin
            group = [
                i
                for i in range(number, min(number + at_once, len(spans)))
                if spans[i][1] - spans[i][0] == size
            ]
            found = compute([spans[i][0] for i in group], size).float().cpu()
            values |= dict(zip(group, found, strict=True))
        first, last = number * step, min(number * step + step, length)
        own = values[number][first - begin : last - begin]
        if number:
            before = values.pop(number - 1)[first - spans[number - 1][0] :][: len(own)]
            share = ((torch.arange(len(own)) + 0.5) / step)[:, None]
            own = before + share * (own - before)
        made.append(own)
    return torch.cat(made)


def _faded(starts: list[int], index: int, place: Tensor, fade: int) -> Tensor:
    """Weights of a window at its places (window,), faded in the middles of its overlaps."""
    window, weight = len(place), torch.ones(len(place))
    if index > 0:
        middle = (starts[index - 1] - starts[index] + window) / 2
        weight = torch.minimum(weight, (place - middle + fade / 2 + 1) / (fade + 1))
    if index + 1 < len(starts):
        middle = (starts[index + 1] - starts[index] + window) / 2
        weight = torch.minimum(weight, (middle - place + fade / 2) / (fade + 1))
    return weight.clamp_min(0)
