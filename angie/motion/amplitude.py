"""How far a photo's person is moved: by their size, and by how sure their regions are."""

from torch import Tensor

from angie.motion.statistics import MotionStatistics
from data_prep.errors import BadInput
from mraa.avd import hull_scale
from mraa.motion import Motion, amplified

LARGEST = 2.0
"""Largest amplitude."""

USUAL = 1.3
"""Spread up to which a region is sure of itself, in parts of the largest of the training motion.
Of 52 frames of people that the renderer that ships has learnt from, 2.6 % of the regions spread
further; of 23 photos and videos of others 21 %."""

LEAST = 0.4
"""Least part of its motion that a region which is not sure of itself keeps."""

STRANGE = 0.95
"""Mean spread of the regions above which a photo is unlike what was learnt: of the same 52 frames
none, of the 23 others 15, close-ups and a drawing among them; 8 with hands at rest are below."""

LEAST_STRANGE = 0.6
"""Least part of its motion that such a photo keeps as a whole."""

ADVICE = (
    "this photo is unlike the people that the model has learnt, so it moves less; show the upper "
    "body with both hands, give a smaller --amplitude, or train on a video of this speaker (angie "
    "train DATASET -o BUNDLE --stage renderer --from shipped)"
)
"""What can be done about a photo that is unlike what was learnt."""


def check_amplitude(amplitude: float) -> None:
    """Refuse what is no amplitude.

    Raises:
        BadInput: below 0 or above `LARGEST`.
    """
    if not 0 <= amplitude <= LARGEST:
        raise BadInput(f"--amplitude {amplitude:g}: give 0 to {LARGEST:g}; 1 is as it is made")


def spread(pose: Motion, statistics: MotionStatistics) -> Tensor:
    """How far each region's heatmap spreads, (K,), in parts of the largest of the training motion.

    The larger of the diagonal of its Cholesky factor over the 99.5th percentile of training: what
    an estimator is not sure of it spreads over the picture.

    Args:
        pose: of a photo, one frame.
        statistics: of the motion of training.
    """
    diagonal = pose.cholesky[..., 0, :, ::2]
    return (diagonal / statistics.diagonal_high).amax(dim=-1)


def trust(spread: Tensor) -> Tensor:
    """What part of its motion each region is given, (K,) in (0, 1], by its spread (K,)."""
    region = (USUAL / spread).clamp(LEAST, 1)
    return region * (STRANGE / spread.mean()).clamp(LEAST_STRANGE, 1)


def is_stranger(spread: Tensor) -> bool:
    """Whether a photo is unlike what was learnt, by the spread (K,) of its regions."""
    return bool(spread.mean() > STRANGE)


def held_back(
    motion: Motion, pose: Motion, statistics: MotionStatistics, amplitude: float = 1.0
) -> tuple[Motion, list[str]]:
    """Motion around the pose of a photo, as far as its regions are to be trusted.

    Args:
        motion: T frames.
        pose: of the photo, one frame.
        statistics: of the motion of training.
        amplitude: what the user wants of it, see `check_amplitude`.

    Returns:
        the motion; and a note if the photo is unlike what was learnt, else nothing.
    """
    found = spread(pose, statistics)
    notes = [ADVICE] if is_stranger(found) else []
    return amplified(motion, pose, amplitude * trust(found)), notes


def scale_displacement(
    motion: Motion, pose: Motion, statistics: MotionStatistics, style: str | None = None
) -> Motion:
    """Scale shifts away from `pose` by the person's size against a training speaker's.

    The size is the square root of the area that the regions span (MRAA's relative mode). The
    training speaker is the one whose style the motion has; without a style, or with one that is
    nobody's, the mean of all.
    """
    one = None if style is None or set(style) & set(":,") else style  # a mixture or a point
    mean = statistics.rest.mean(dim=0)
    rest = Motion.from_vector((mean if one is None else statistics.rest_of(one))[None])
    scale = hull_scale(pose.shift[0], rest.shift[0])
    return Motion(pose.shift + scale * (motion.shift - pose.shift), motion.cholesky)
