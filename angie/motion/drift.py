"""Drift bounding: integration of generated deltas that stays near the rest pose for hours.

Summed deltas wander: random error grows with the square root of time, a constant error with time.
The paper's clips last about ten seconds and need nothing; longer speech does.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from data_prep.rates import FPS

TAU = 8.0
"""Seconds in which leaky integration forgets a displacement to 1/e."""

AUTO_FRAMES = 10 * FPS
"""Bounding `auto` begins above this length."""

LINEAR = 0.8
"""Part of the range in which the soft range leaves motion untouched."""

PAUSE = FPS * 2 // 5
"""Frames of calm (0.4 s) that make a pause."""

APART = 8 * FPS
"""Least frames from one re-anchoring to the next."""

REANCHOR = 0.5
"""Part of the way to the nearest training pose that re-anchoring goes."""

MODES = ("auto", "on", "off")


def bounded(mode: str, frames: int) -> bool:
    """Whether motion of `frames` frames is to be bounded in mode auto (above 10 s), on or off."""
    if mode not in MODES:
        raise ValueError(f"bounding is one of {', '.join(MODES)}, not {mode!r}")
    return mode == "on" or (mode == "auto" and frames > AUTO_FRAMES)


def integrate_leaky(delta: Tensor, start: Tensor, rest: Tensor, tau: float = TAU) -> Tensor:
    """Integrate deltas with a leak toward the rest pose.

    y_j = rho y_{j-1} + d_j on the displacement y from the rest pose, rho = exp(-1 / (25 tau)),
    y_1 = start - rest; the first delta is discarded. A constant delta d settles at d / (1 - rho).

    Args:
        delta: (..., T, C) relative motion.
        start: (..., C) pose of frame 1.
        rest: (..., C) pose the motion leaks toward.
        tau: time constant, seconds.

    Returns:
        (..., T, C) float32 absolute motion on the device of `delta`; exact `start` at frame 1.
    """
    rho = math.exp(-1 / (FPS * tau))
    steps = delta.detach().cpu().double().clone()
    steps[..., 0, :] = (start - rest).cpu().double()
    rows = np.moveaxis(steps.numpy(), -2, 0)  # one frame after the other, in place
    for before, row in zip(rows[:-1], rows[1:], strict=True):
        row += rho * before
    motion = steps + rest.cpu().double().unsqueeze(-2)
    motion = motion.float().to(delta.device)
    motion[..., 0, :] = start
    return motion


def soft_range(displacement: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """Bend displacements softly into a range.

    With centre c, half width h and u = (y - c) / h: |u| <= 0.8 is untouched, beyond it
    |u| -> 0.8 + 0.2 tanh((|u| - 0.8) / 0.2), continuous with its derivative. The range is widened
    so that the first frame lies in the untouched part.

    Args:
        displacement: (..., T, C) displacements from the rest pose.
        low: (C,) lower ends.
        high: (C,) upper ends, not below `low`.

    Returns:
        (..., T, C) displacements in [low, high] (widened where frame 1 needs it).
    """
    centre, half = (low + high) / 2, (high - low) / 2
    first = displacement[..., :1, :]
    half = torch.maximum(half, (first - centre).abs() / LINEAR).clamp_min(1e-6)
    place = (displacement - centre) / half
    size = place.abs()
    knee = 1 - LINEAR
    bent = LINEAR + knee * torch.tanh((size - LINEAR) / knee)
    return torch.where(size > LINEAR, centre + half * place.sign() * bent, displacement)


def activity(delta: Tensor) -> Tensor:
    """How much moves in each frame: root mean square over the channels of normalised deltas.

    Args:
        delta: (..., T, C) deltas in units of their training standard deviation.

    Returns:
        (..., T, 1).
    """
    return delta.square().mean(dim=-1, keepdim=True).sqrt()


def remove_mean(delta: Tensor, mean: Tensor) -> Tensor:
    """Take the constant part of decoded deltas away, in proportion to the activity of a frame.

    What a decoder adds in the long run it adds while something moves; taking a plain constant away
    would set a silent, still person in motion. Over the training set the result has mean zero.

    Args:
        delta: (..., T, C) decoded deltas, normalised.
        mean: (C,) sum of decoded deltas over the training set, divided by the sum of activities.

    Returns:
        (..., T, C) deltas, normalised.
    """
    return delta - mean * activity(delta)


def pauses(calm: Tensor) -> list[int]:
    """Frames at which motion may be re-anchored: 0.4 s calm, 8 s after the one before.

    Args:
        calm: (T,) bool, frames with little motion.
    """
    found, run, last = [], 0, 0
    for frame, still in enumerate(calm.tolist()):
        run = run + 1 if still else 0
        if run >= PAUSE and frame - last >= APART:
            found.append(frame)
            last = frame
    return found


def reanchor(
    displacement: Tensor, frames: list[int], anchors: Tensor, scale: Tensor, tau: float = TAU
) -> Tensor:
    """Fade displacements half-way toward the nearest pose of the training set, in pauses.

    At each of the given frames the displacement is moved by half its difference from the nearest
    anchor, over one second; what was moved is then forgotten as leaky integration forgets.

    Args:
        displacement: (T, C) from the rest pose.
        frames: where to begin, at least a second apart; see `pauses`.
        anchors: (n, C) displacements of calm training poses, n > 0.
        scale: (C,) in units of which nearness is measured.
        tau: of the leaky integration, seconds.

    Returns:
        (T, C).
    """
    rho = math.exp(-1 / (FPS * tau))
    moved = displacement.clone()
    held = torch.zeros_like(displacement[0])
    for place, frame in enumerate(frames):
        end = frames[place + 1] if place + 1 < len(frames) else len(moved)
        here = displacement[frame] + held
        nearest = ((anchors - here) / scale).square().sum(dim=-1).argmin()
        push = REANCHOR * (anchors[nearest] - here)
        later = torch.arange(end - frame, dtype=displacement.dtype)[:, None]
        fade = 0.5 - 0.5 * torch.cos(math.pi * (later / FPS).clamp_max(1))
        moved[frame:end] += rho**later * (held + fade * push)
        held = rho ** (end - frame) * (held + push)
    return moved


@dataclass(frozen=True)
class Anchors:
    """What re-anchoring goes by.

    Attributes:
        poses: (n, C) displacements of calm training poses.
        scale: (C,) standard deviation of the displacement.
        calm: (T,) bool, frames of the motion with little movement.
    """

    poses: Tensor
    scale: Tensor
    calm: Tensor


def integrate_bounded(
    delta: Tensor,
    start: Tensor,
    rest: Tensor,
    low: Tensor,
    high: Tensor,
    anchors: Anchors | None = None,
) -> Tensor:
    """Integrate generated deltas without drift: leak toward the rest pose, soft range.

    Args:
        delta: (T, C) relative motion, its constant part removed.
        start: (C,) pose of frame 1.
        rest: (C,) rest pose of the speaker, or `start` for an unknown one.
        low: (C,) 0.2th percentile of the training displacement from rest.
        high: (C,) 99.8th percentile.
        anchors: re-anchor in pauses; None does not.

    Returns:
        (T, C) absolute motion; frame 1 is `start`.
    """
    displacement = integrate_leaky(delta, start, rest) - rest
    if anchors is not None and len(anchors.poses):
        begins = pauses(anchors.calm)
        displacement = reanchor(displacement, begins, anchors.poses, anchors.scale)
    motion = rest + soft_range(displacement, low, high)
    motion[..., 0, :] = start
    return motion
