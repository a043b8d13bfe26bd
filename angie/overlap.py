"""Long sequences in overlapping windows that fade into one another."""

import math
from collections.abc import Callable

import torch
from torch import Tensor

BLENDS = ("linear", "hann")
"""How windows become one sequence.

"linear": windows every half window, in the middles of whose overlaps one becomes the next.
"hann": windows every quarter, weighted by a Hann window. The sums of the weights and of their
squares are then the same at every frame, so that no place of a window shows in the result, at
twice as many windows. Near both ends of the sequence fewer windows meet.
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
    compute: Callable[[list[int]], Tensor],
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
        compute: from n first frames to the windows' values (n, window, C).
        blend: "linear" or "hann".
        at_once: most windows in one call of `compute`.
        fade: frames of a linear ramp, in the middle of the overlap.

    Returns:
        (T, C) blended values.

    Raises:
        ValueError: another blend, or nothing to cover.
    """
    if blend not in BLENDS:
        raise ValueError(f"blend is one of {', '.join(BLENDS)}, not {blend!r}")
    hop = window // (2 if blend == "linear" else 4)
    window = min(window, length)
    starts = window_starts(length, window, min(hop, window))
    place = torch.arange(window, dtype=torch.float32)
    total, weight = None, torch.zeros(length, 1)
    for begin in range(0, len(starts), at_once):
        group = starts[begin : begin + at_once]
        values = compute(group).float().cpu()
        if total is None:
            total = torch.zeros(length, values.shape[-1])
        for index, (first, value) in enumerate(zip(group, values, strict=True), begin):
            part = _hann(place) if blend == "hann" else _faded(starts, index, place, fade)
            total[first : first + window] += value * part[:, None]
            weight[first : first + window] += part[:, None]
    assert total is not None  # window_starts refuses an empty sequence
    return total / weight


def _hann(place: Tensor) -> Tensor:
    """Weights of a window at its places (window,), a Hann window sampled between its zeros."""
    return torch.sin(math.pi * (place + 0.5) / len(place)).square()


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
