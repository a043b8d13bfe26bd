"""How motion begins and ends: at a rest pose, and back to it."""

import torch

from angie.motion.statistics import MotionStatistics
from mraa.avd import hull_scale
from mraa.motion import Motion


def rest_pose(pose: Motion, statistics: MotionStatistics, style: str | None = None) -> Motion:
    """Rest pose of a training speaker, as large as the photo's person and where that one is.

    Args:
        pose: of the photo, one frame, which gives size and place: the square root of the area
            that the regions span, and their mean.
        statistics: of the training speakers.
        style: whose rest pose; None, or a style that is no speaker's name, is the mean of all.
    """
    one = style if style in statistics.speakers else None
    rest = statistics.rest.mean(dim=0) if one is None else statistics.rest_of(one)
    known = Motion.from_vector(rest[None])
    scale = hull_scale(pose.shift[0], known.shift[0])
    centre, own = (shift.mean(dim=1, keepdim=True) for shift in (pose.shift, known.shift))
    return Motion(centre + scale * (known.shift - own), scale * known.cholesky)


def faded(motion: Motion, rest: Motion, frames: int) -> Motion:
    """Motion whose last `frames` frames go smoothly to `rest`, which the last one is.

    Args:
        motion: T frames.
        rest: one frame.
        frames: 0 leaves the motion as it is; more than T - 1 are cut to that.
    """
    frames = min(frames, motion.frames - 1)
    if frames < 1:
        return motion
    place = torch.arange(1, frames + 1, dtype=torch.float32) / frames
    share = torch.cat([torch.zeros(motion.frames - frames), place**2 * (3 - 2 * place)])[:, None]
    return motion.like(motion.vector() * (1 - share) + rest.vector() * share)
