"""Region motion: shifts and Cholesky factors over time, relative deltas, integration.

A pose is the shift `mu` (K, 2) of every region and the lower Cholesky factor
`L = [[l1, 0], [l2, l3]]` of its covariance, stored as (l1, l2, l3). Coordinates are (x right,
y down) in [-1, 1]. The motion vector of a frame is the shift block (2K channels, region by
region) followed by the Cholesky block (3K channels): `[mu ; L]`, 100 numbers for 20 regions
(ANGIE, NeurIPS 2022, section 3.2).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_prep.arrays import read_arrays
from data_prep.errors import BadInput
from mraa.affine import EPSILON, affine_from_covariance, decode_cholesky

FLOOR = 0.3
CEILING = 1.5
"""Generated diagonals stay in [0.3 x p0.5, 1.5 x p99.5] of training, which keeps C renderable."""


@dataclass(frozen=True)
class Motion:
    """Region motion of T frames.

    Attributes:
        shift: (..., T, K, 2) float32, region centres (x, y) in [-1, 1].
        cholesky: (..., T, K, 3) float32, (l1, l2, l3) of the covariances' Cholesky factors;
            (..., T, K, 0) for points without extent, such as joints.
    """

    shift: Tensor
    cholesky: Tensor

    def __post_init__(self) -> None:
        frames, pairs = self.shift.shape[:-1], self.shift.shape[-1]
        if pairs != 2 or self.cholesky.shape not in ((*frames, 3), (*frames, 0)):
            raise ValueError(
                f"shift must be (..., T, K, 2) and cholesky (..., T, K, 3) or (..., T, K, 0), "
                f"not {tuple(self.shift.shape)} and {tuple(self.cholesky.shape)}"
            )

    @classmethod
    def from_vector(cls, vector: Tensor) -> "Motion":
        """Split motion vectors (..., T, 5K) into shifts and Cholesky factors."""
        regions, rest = divmod(vector.shape[-1], 5)
        if rest:
            raise ValueError(f"a motion vector has 5 numbers a region, not {vector.shape[-1]}")
        shift, cholesky = vector.split([2 * regions, 3 * regions], dim=-1)
        return cls(shift.unflatten(-1, (regions, 2)), cholesky.unflatten(-1, (regions, 3)))

    @classmethod
    def of_points(cls, points: Tensor) -> "Motion":
        """Points (..., T, K, 2) without extent."""
        return cls(points, points.new_zeros(*points.shape[:-1], 0))

    def like(self, vector: Tensor) -> "Motion":
        """Motion of vectors (..., T, C), of regions or of points as this motion is."""
        shift, cholesky = vector.tensor_split([2 * self.regions], dim=-1)
        kept = (*vector.shape[:-1], self.regions)
        return Motion(shift.reshape(*kept, 2), cholesky.reshape(*kept, self.cholesky.shape[-1]))

    @property
    def has_extent(self) -> bool:
        """Whether there are Cholesky factors; points have none."""
        return self.cholesky.shape[-1] > 0

    def vector(self) -> Tensor:
        """Motion vectors (..., T, 5K): 2K shift channels, then 3K Cholesky channels, if any."""
        return torch.cat([self.shift.flatten(-2), self.cholesky.flatten(-2)], dim=-1)

    @property
    def frames(self) -> int:
        """Number of frames T."""
        return self.shift.shape[-3]

    @property
    def regions(self) -> int:
        """Number of regions K."""
        return self.shift.shape[-2]

    def __getitem__(self, frames: slice) -> "Motion":
        """The motion of a slice of frames."""
        return Motion(self.shift[..., frames, :, :], self.cholesky[..., frames, :, :])

    def covariance(self) -> Tensor:
        """Covariances (..., T, K, 2, 2), C = L L^T."""
        return decode_cholesky(self.cholesky)


def pack_covariance(covariance: Tensor) -> Tensor:
    """Covariances (..., T, K, 2, 2) as (..., T, 3K): c11, c12, c22 of each region."""
    parts = [covariance[..., 0, 0], covariance[..., 1, 0], covariance[..., 1, 1]]
    return torch.stack(parts, dim=-1).flatten(-2)


def pack_extents(covariance: Tensor) -> Tensor:
    """Covariances (..., T, K, 2, 2) and their roots A = U sqrt(S) as (..., T, 7K): C, then A."""
    affine = affine_from_covariance(covariance, "svd").flatten(-3)
    return torch.cat([pack_covariance(covariance), affine], dim=-1)


def unpack_covariance(packed: Tensor) -> Tensor:
    """Covariances (..., T, K, 2, 2) of `pack_covariance`."""
    a, b, d = packed.unflatten(-1, (-1, 3)).unbind(-1)
    return torch.stack([a, b, b, d], dim=-1).unflatten(-1, (2, 2))


def deltas(vector: Tensor) -> Tensor:
    """Relative motion d_j = x_j - x_{j-1}; the first frame has no predecessor and gets zero.

    Args:
        vector: (..., T, C) motion vectors.

    Returns:
        (..., T, C), the same length, first frame zero.
    """
    return torch.cat([torch.zeros_like(vector[..., :1, :]), vector.diff(dim=-2)], dim=-2)


def integrate(delta: Tensor, start: Tensor) -> Tensor:
    """Absolute motion x_j = x_1 + sum_{i=2..j} d_i (ANGIE, section 3.2).

    The first delta is discarded: frame 1 is the start pose. `integrate(deltas(x), x[0])` is `x`.

    Args:
        delta: (..., T, C) relative motion.
        start: (..., C) motion vector of frame 1.

    Returns:
        (..., T, C) motion vectors.
    """
    steps = delta.clone()
    steps[..., 0, :] = start
    return steps.cumsum(dim=-2)


def positive(motion: Motion) -> Motion:
    """Make the diagonals of L positive: l <- ReLU(l) + 1e-5 for l1 and l3.

    To be applied once, after integration and refinement: inside the recursion it would break the
    additivity of the deltas (ANGIE, section 3.2).
    """
    if not motion.has_extent:
        return motion
    l1, l2, l3 = motion.cholesky.unbind(-1)
    factor = torch.stack([l1.relu() + EPSILON, l2, l3.relu() + EPSILON], dim=-1)
    return Motion(motion.shift, factor)


def render_floor(motion: Motion, low: Tensor, high: Tensor, start: Motion | None = None) -> Motion:
    """Keep generated diagonals of L where the renderer has seen them.

    Args:
        motion: generated motion, K regions.
        low: (K, 2) the 0.5th percentile of (l1, l3) in training.
        high: (K, 2) the 99.5th percentile.
        start: pose of one frame whose diagonals are always allowed, so that frame 1 stays exact.

    Returns:
        Motion with l1, l3 in [0.3 low, 1.5 high], widened to contain the start pose.
    """
    if not motion.has_extent:
        return motion
    low, high = FLOOR * low, CEILING * high
    if start is not None:
        diagonal = start.cholesky[..., 0, :, ::2]
        low, high = torch.minimum(low, diagonal), torch.maximum(high, diagonal)
    l1, l2, l3 = motion.cholesky.unbind(-1)
    l1 = torch.clamp(l1, low[..., 0], high[..., 0])
    l3 = torch.clamp(l3, low[..., 1], high[..., 1])
    return Motion(motion.shift, torch.stack([l1, l2, l3], dim=-1))


def amplified(motion: Motion, pose: Motion, amplitude: Tensor | float) -> Motion:
    """Motion with its distance from a pose scaled; the pose itself where the amplitude is 0.

    Shifts and Cholesky factors are scaled alike. Up to 1 a factor lies between two proper ones and
    so is one; above, its diagonal is held above half of the smaller of the two, so that
    covariances stay positive definite.

    Args:
        motion: T frames.
        pose: one frame.
        amplitude: (K,) of every region, or one for all; not negative.
    """
    scale = torch.as_tensor(amplitude).reshape(-1, 1)
    shift = pose.shift + scale * (motion.shift - pose.shift)
    factor = pose.cholesky + scale * (motion.cholesky - pose.cholesky)
    if motion.has_extent:
        least = torch.minimum(motion.cholesky, pose.cholesky)[..., ::2] / 2
        l1, l3 = torch.maximum(factor[..., ::2], least).unbind(-1)
        factor = torch.stack([l1, factor[..., 1], l3], dim=-1)
    return Motion(shift, factor)


def write_motion(path: Path, motion: Motion, estimator: str = "") -> None:
    """Write the motion of a clip as .npz: shift (T,K,2), cholesky (T,K,3), and its origin.

    `estimator`: hash of the region estimator that measured it.
    """
    np.savez(
        path,
        shift=motion.shift.detach().cpu().numpy().astype(np.float32),
        cholesky=motion.cholesky.detach().cpu().numpy().astype(np.float32),
        estimator=np.array(estimator),
    )


def read_motion(path: Path, estimator: str | None = None) -> Motion:
    """Read the motion of a clip.

    `estimator`: hash of the region estimator that must have measured it; None accepts any, and
    files that do not say.

    Raises:
        BadInput: missing, unreadable, or measured by another region estimator.
    """
    wanted = "run the motion stage"
    if estimator is None:
        wanted = "wanted is an .npz of regions, with `shift` (T, K, 2) and `cholesky` (T, K, 3)"
    try:
        arrays = read_arrays(path, ("shift", "cholesky", "estimator"))
        if "" in arrays:
            raise ValueError("a single array")
        motion = _checked(arrays["shift"], arrays["cholesky"])
        origin = "" if estimator is None else str(arrays["estimator"])
    except KeyError as error:
        raise BadInput(f"{path}: not a motion file (has no {error}); {wanted}") from error
    except ValueError as error:
        raise BadInput(f"{path}: not a motion file ({error}); {wanted}") from error
    if estimator is not None and origin != estimator:
        raise BadInput(
            f"{path}: measured by another region estimator ({origin[:12] or 'unknown'}, "
            f"not {estimator[:12]}); run the motion stage again"
        )
    return motion


def _checked(shift: NDArray, cholesky: NDArray) -> Motion:
    """Motion of arrays of a file; ValueError where they are none."""
    if shift.ndim != 3 or not shift.size or cholesky.shape != (*shift.shape[:2], 3):
        raise ValueError(f"shapes {shift.shape} and {cholesky.shape}")
    with np.errstate(over="ignore"):  # what overflows is told below
        arrays = [array.astype(np.float32) for array in (shift, cholesky)]
    if not all(np.isfinite(array).all() for array in arrays):
        raise ValueError("numbers that are not finite in float32")
    if (arrays[1][..., ::2] <= 0).any():
        raise ValueError("l1 or l3 of a Cholesky factor is not above 0")
    return Motion(*map(torch.from_numpy, arrays))
