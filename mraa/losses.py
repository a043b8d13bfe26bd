"""Equivariance losses of the regions (MRAA, section 3.5).

Random thin-plate transforms for the equivariance losses (FOMM, MRAA).
"""

import functools
from dataclasses import dataclass

import torch
from torch import Tensor

from mraa.affine import fix_sign, inverse
from mraa.grid import coordinate_grid, warp
from mraa.regions import RegionEstimator, Regions

AFFINE_SIGMA = 0.05
"""Standard deviation of the noise on the affine part."""


PLATE_SIGMA = 0.005
"""Standard deviation of the thin-plate coefficients."""


TPS_POINTS = 5
"""Control points a side, spread over [-1, 1]."""


@dataclass(frozen=True)
class ThinPlate:
    """A smooth map W of the plane, one for each of B images."""

    theta: Tensor
    """(B, 2, 3) affine part."""
    coefficients: Tensor
    """(B, 1, 25) weights of the control points, the same for x and y."""

    def points(self, coordinates: Tensor) -> Tensor:
        """W of points (B, n, 2), (x, y) in [-1, 1]: (B, n, 2)."""
        linear = coordinates @ self.theta[:, :, :2].mT + self.theta[:, None, :, 2]
        radial = _basis(coordinates) * self.coefficients  # (B, n, 25)
        return linear + radial.sum(-1, keepdim=True)

    def image(self, image: Tensor, *, align_corners: bool) -> Tensor:
        """Image (B, C, H, W) seen through W, reflected at the borders."""
        height, width = image.shape[2:]
        grid = coordinate_grid(height, width, image.device)
        with torch.autocast(image.device.type, enabled=False):  # coordinates need float32
            linear = torch.einsum("hwj,bij->bhwi", grid, self.theta[:, :, :2])
            radial = _grid_basis(height, width, image.device) @ self.coefficients[:, 0].T
            radial = radial.T.view(-1, height, width, 1)
            flow = linear + self.theta[:, None, None, :, 2] + radial
        return warp(image, flow, align_corners=align_corners, padding="reflection")

    def jacobian(self, coordinates: Tensor) -> Tensor:
        """Derivative of W at points (B, n, 2): (B, n, 2, 2), row = output, column = input.

        Closed form; the sign of a zero offset counts as 0. Differentiable in the points.
        """
        control = coordinate_grid(TPS_POINTS, TPS_POINTS, coordinates.device).view(1, -1, 2)
        offset = coordinates[:, :, None] - control[:, None]  # (B, n, 25, 2)
        distance = offset.abs().sum(-1)
        slope = 2 * distance * torch.log(distance + 1e-6) + distance**2 / (distance + 1e-6)
        row = ((slope * self.coefficients)[..., None] * torch.sign(offset)).sum(2)  # (B, n, 2)
        return self.theta[:, None, :, :2] + row[:, :, None, :]


def _basis(coordinates: Tensor) -> Tensor:
    """Radial terms `d^2 log(d + 1e-6)`, d the L1 distance: (..., 2) to (..., 25)."""
    control = coordinate_grid(TPS_POINTS, TPS_POINTS, coordinates.device).view(-1, 2)
    distance = (coordinates[..., None, :] - control).abs().sum(-1)
    return distance**2 * torch.log(distance + 1e-6)


@functools.lru_cache(maxsize=4)
def _grid_basis(height: int, width: int, device: torch.device) -> Tensor:
    """Radial terms of every pixel, (height * width, 25): the same for every transform."""
    return _basis(coordinate_grid(height, width, device).view(-1, 2))


TPS_NUMBERS = 6 + TPS_POINTS**2
"""Random numbers that make a transform."""


def thin_plate(noise: Tensor) -> ThinPlate:
    """Transforms from standard normal numbers (B, `TPS_NUMBERS`)."""
    affine = torch.eye(2, 3, device=noise.device) + AFFINE_SIGMA * noise[:, :6].unflatten(1, (2, 3))
    return ThinPlate(affine, PLATE_SIGMA * noise[:, None, 6:])


def random_thin_plate(batch: int, device: torch.device | None = None) -> ThinPlate:
    """Draw B transforms from torch's current random state."""
    return thin_plate(torch.randn(batch, TPS_NUMBERS, device=device))


@dataclass(frozen=True)
class Equivariance:
    """The two equivariance losses (scalars, unweighted) of MRAA."""

    shift: Tensor
    """mean |mu_d - W(mu_t)|"""
    affine: Tensor
    """mean |I - sign A_d^-1 J_W(mu_t) A_t|"""


def equivariance(regions: Regions, transformed: Regions, transform: ThinPlate) -> Equivariance:
    """Compare regions of a frame with those of the frame seen through `transform`.

    Args:
        regions: of the frame, (B, K).
        transformed: of `transform.image(frame)`.
        transform: W.
    """
    shift = (regions.shift - transform.points(transformed.shift)).abs().mean()
    product = inverse(regions.affine) @ transform.jacobian(transformed.shift) @ transformed.affine
    identity = torch.eye(2, device=product.device)
    return Equivariance(shift, (identity - fix_sign(product)).abs().mean())


def equivariance_of(
    estimator: RegionEstimator,
    frame: Tensor,
    regions: Regions,
    transform: ThinPlate,
    *,
    align_corners: bool,
) -> Equivariance:
    """Equivariance losses of an estimator, given its regions of frames (B, 3, H, W)."""
    transformed = estimator(transform.image(frame, align_corners=align_corners))
    with torch.autocast(frame.device.type, enabled=False):
        return equivariance(regions, transformed, transform)
