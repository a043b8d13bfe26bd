"""What of the motion is quantised: relative shift and Cholesky factor, or a variant of it.

ANGIE (NeurIPS 2022), section 3.2 and the rows of its Table 3. A variant is one setting,
`vq.quant`; every other part of training and generation is the same for all.

| quant | shift | extent |
|---|---|---|
| full | relative | Cholesky factor, relative |
| no_quant | relative | Cholesky factor, relative; regressed from the sound without codes |
| mu_L | absolute | Cholesky factor, absolute |
| dmu_L | relative | Cholesky factor, absolute |
| mu_dL | absolute | Cholesky factor, relative |
| no_cholesky | relative | covariance (c11, c12, c22), relative |
| naive | absolute | covariance and its root A, absolute, a codebook each (equations 4 to 6) |
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from angie.motion.statistics import MotionStatistics
from data_prep.errors import BadInput
from mraa.affine import decode_cholesky, encode_cholesky
from mraa.motion import Motion, integrate, pack_covariance, pack_extents, unpack_covariance

QUANTS = ("full", "no_quant", "mu_L", "dmu_L", "mu_dL", "no_cholesky", "naive")


@dataclass(frozen=True)
class Channels:
    """Motion vectors to the numbers that are quantised, and back.

    A relative channel holds the change from the frame before in units of its training standard
    deviation, without mean; an absolute one the value less its training mean, in units of its
    standard deviation.

    Attributes:
        regions: K.
        relative: (C,) bool, channels that hold changes.
        centre: (C,) taken away from absolute channels, zero for relative ones.
        scale: (C,) what a channel is divided by.
        covariance: the channels after the shift's are of C in place of L.
        affine: further 4K channels are of A, which is then not derived from C.
    """

    regions: int
    relative: Tensor
    centre: Tensor
    scale: Tensor
    covariance: bool
    affine: bool = False

    @classmethod
    def of(cls, statistics: MotionStatistics, quant: str = "full") -> "Channels":
        """The channels of a variant.

        Raises:
            BadInput: statistics from before the variant existed, or points without extent in a
                variant that needs it.
        """
        if quant not in QUANTS:
            raise ValueError(f"quant is one of {', '.join(QUANTS)}, not {quant!r}")
        relative = torch.ones_like(statistics.delta_scale, dtype=torch.bool)
        centre, scale = torch.zeros_like(statistics.delta_scale), statistics.delta_scale.clone()
        regions, split = statistics.regions, 2 * statistics.regions
        if quant == "naive":
            return cls._naive(statistics)
        if quant in ("mu_L", "dmu_L", "mu_dL", "no_cholesky"):
            if not statistics.has_extent:
                raise BadInput(f"vq.quant={quant}: points have no extent; full and no_quant work")
            if not len(statistics.pose_mean):
                raise BadInput(f"vq.quant={quant}: needs newer statistics; run the motion stage")
            relative[:split] = quant not in ("mu_L", "mu_dL")
            relative[split:] = quant not in ("mu_L", "dmu_L")
            centre = torch.where(relative, centre, statistics.pose_mean)
            scale = torch.where(relative, scale, statistics.pose_deviation)
        covariance = quant == "no_cholesky"
        if covariance:
            scale[split:] = statistics.covariance_scale
        return cls(regions, relative, centre, scale, covariance)

    @classmethod
    def _naive(cls, statistics: MotionStatistics) -> "Channels":
        """Shift, C and A, all absolute."""
        if not statistics.has_extent:
            raise BadInput("vq.quant=naive: points have no extent; full and no_quant work")
        if not len(statistics.extent_mean):
            raise BadInput("vq.quant=naive: needs newer statistics; run the motion stage")
        split = 2 * statistics.regions
        centre = torch.cat([statistics.pose_mean[:split], statistics.extent_mean])
        scale = torch.cat([statistics.pose_deviation[:split], statistics.extent_deviation])
        relative = torch.zeros_like(centre, dtype=torch.bool)
        return cls(statistics.regions, relative, centre, scale, covariance=True, affine=True)

    @property
    def all_relative(self) -> bool:
        """Whether no channel is absolute."""
        return bool(self.relative.all())

    def to(self, device: torch.device) -> "Channels":
        """The same on a device."""
        relative, centre, scale = (v.to(device) for v in (self.relative, self.centre, self.scale))
        return Channels(self.regions, relative, centre, scale, self.covariance, self.affine)

    def normalise(self, poses: Tensor) -> Tensor:
        """What is quantised (..., T, C) of motion vectors (..., T + 1, C) with a leading frame."""
        poses = self._packed(poses)
        changes = poses.diff(dim=-2)
        return torch.where(self.relative, changes, poses[..., 1:, :] - self.centre) / self.scale

    def integrate(self, values: Tensor, start: Tensor) -> Tensor:
        """Motion vectors (..., T, C) of what was quantised (..., T, C).

        Relative channels are summed up from the start pose, the first change discarded.

        Args:
            values: normalised values.
            start: (..., C) motion vector of frame 1.
        """
        return self._unpacked(self._absolute(values, start))

    def _absolute(self, values: Tensor, start: Tensor) -> Tensor:
        """Absolute numbers (..., T, C) of what was quantised, C or L as they were quantised."""
        start = self._packed(start[..., None, :])[..., 0, :]
        values = values * self.scale
        return torch.where(self.relative, integrate(values, start), values + self.centre)

    def broken(self, values: Tensor, start: Tensor) -> Tensor:
        """Frames (..., T) bool that cannot be drawn, for some region; see `integrate`.

        Its covariance is not positive definite, or its affine root turns the picture over or has
        no inverse. With the Cholesky factor there are none.
        """
        if not self.covariance:
            return torch.zeros(values.shape[:-1], dtype=torch.bool)
        numbers = self._absolute(values, start)
        parts = [2 * self.regions, 3 * self.regions]
        _, packed, affine = numbers.split([*parts, numbers.shape[-1] - sum(parts)], dim=-1)
        a, b, d = packed.unflatten(-1, (-1, 3)).unbind(-1)
        broken = ((a <= 0) | (a * d <= b.square())).any(dim=-1)
        if self.affine:
            a, b, c, d = affine.unflatten(-1, (-1, 4)).unbind(-1)
            broken = broken | (a * d <= b * c).any(dim=-1)
        return broken

    def _packed(self, poses: Tensor) -> Tensor:
        """Motion vectors with C in place of L, if that is what is quantised."""
        if not self.covariance:
            return poses
        motion = Motion.from_vector(poses)
        pack = pack_extents if self.affine else pack_covariance
        packed = pack(decode_cholesky(motion.cholesky))
        return torch.cat([motion.shift.flatten(-2), packed], dim=-1)

    def _unpacked(self, poses: Tensor) -> Tensor:
        """The reverse; a covariance that is not positive definite becomes a thin one."""
        if not self.covariance:
            return poses
        shift, packed = poses[..., : 5 * self.regions].split(
            [2 * self.regions, 3 * self.regions], dim=-1
        )
        factors = encode_cholesky(unpack_covariance(packed))
        return torch.cat([shift, factors.flatten(-2)], dim=-1)
