"""Equivariance losses of the regions (MRAA, section 3.5)."""

from dataclasses import dataclass

import torch
from torch import Tensor

from mraa.affine import fix_sign, inverse
from mraa.regions import RegionEstimator, Regions
from mraa.transform import ThinPlate


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
