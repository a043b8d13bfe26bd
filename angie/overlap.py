"""Long sequences in overlapping windows that fade linearly into one another."""

from collections.abc import Callable

import torch
from torch import Tensor

FADE = 24
"""Frames in which motion that is made in windows of the training length goes from one to the next.

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
    hop: int,
    compute: Callable[[list[int]], Tensor],
    at_once: int = 32,
    fade: int = FADE,
) -> Tensor:
    """Compute windows in groups and blend them with linear ramps.

    Each window is weighted by one everywhere but in the middle of an overlap, where a window
    becomes the next. Weights are divided by their sum, so windows that agree are reproduced
    exactly. Memory beside the result does not grow with the length.

    Args:
        length: frames of the whole sequence, T.
        window: frames of a window; a shorter sequence is one shorter window.
        hop: frames from one window to the next.
        compute: from n first frames to the windows' values (n, window, C).
        at_once: most windows in one call of `compute`.
        fade: frames of a ramp, in the middle of the overlap.

    Returns:
        (T, C) blended values.
    """
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
            ramp = _faded(starts, index, place, fade)
            total[first : first + window] += value * ramp[:, None]
            weight[first : first + window] += ramp[:, None]
    assert total is not None  # window_starts refuses an empty sequence
    return total / weight


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
