"""2x2 algebra of regions: affine from covariance, inverses, the sign fix; always float32."""

from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor


def inverse(matrix: Tensor) -> Tensor:
    """Closed-form inverse of (..., 2, 2) matrices; singular ones give infinities."""
    a, b, c, d = matrix.flatten(-2).unbind(-1)
    adjugate = torch.stack([d, -b, -c, a], dim=-1).unflatten(-1, (2, 2))
    return adjugate / (a * d - b * c)[..., None, None]


class _AxisAngle(torch.autograd.Function):
    """Angle of the major axis of [[a, b], [b, d]] with a gradient bounded for round regions.

    The exact gradient grows as 1 over the relative gap of the eigenvalues. The backward pass
    divides by `q^2 + (0.02 trace)^2` in place of `q^2` and is zero below a relative gap of 1e-3.
    """

    @staticmethod
    def forward(ctx: Any, half_difference: Tensor, b: Tensor, trace: Tensor) -> Tensor:
        ctx.save_for_backward(half_difference, b, trace)
        return 0.5 * torch.atan2(b, half_difference)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, Tensor, None]:
        half_difference, b, trace = ctx.saved_tensors
        squared = half_difference**2 + b**2
        scale = 0.5 * gradients[0] / (squared + (0.02 * trace) ** 2)
        scale = torch.where(2 * squared.sqrt() < 1e-3 * trace, torch.zeros_like(scale), scale)
        return -scale * b, scale * half_difference, None


def _eigen_root(covariance: Tensor) -> Tensor:
    a, b, d = covariance[..., 0, 0], covariance[..., 0, 1], covariance[..., 1, 1]
    half_difference, half_trace = (a - d) / 2, (a + d) / 2
    gap = torch.sqrt(torch.clamp(half_difference**2 + b**2, min=1e-20))
    theta = _AxisAngle.apply(half_difference, b, a + d)
    major = torch.sqrt(half_trace + gap)
    minor = torch.sqrt(torch.clamp(half_trace - gap, min=1e-12))
    cos, sin = torch.cos(theta), torch.sin(theta)
    return torch.stack([cos * major, -sin * minor, sin * major, cos * minor], dim=-1).unflatten(
        -1, (2, 2)
    )


def _lapack_root(covariance: Tensor) -> Tensor:
    """The eigen root with the signs that LAPACK's SVD gives, derived from its steps.

    A Householder reflection takes the first column to `(-|.|, 0)`, so that det U = -1; the
    rotation that follows leaves the joint sign given here. It is LAPACK's on all covariances
    but exactly diagonal ones, whose signs carry nothing.
    """
    a, b, d = covariance[..., 0, 0], covariance[..., 0, 1], covariance[..., 1, 1]
    upright = (a * (d - a) > 2 * b**2) & (b >= 0)  # the second singular value leads
    sign = torch.where(upright, 1.0, -1.0)
    return _eigen_root(covariance) * torch.stack([sign, -sign], dim=-1)[..., None, :]


def _symmetric_root(covariance: Tensor) -> Tensor:
    a, b, d = covariance[..., 0, 0], covariance[..., 0, 1], covariance[..., 1, 1]
    root = torch.sqrt(torch.clamp(a * d - b * b, min=1e-20))
    identity = torch.eye(2, device=covariance.device)
    scale = torch.sqrt(a + d + 2 * root)[..., None, None]
    return (covariance + root[..., None, None] * identity) / scale


MIN_AXIS = 0.015
"""Shortest semi-axis of a region that is rendered, in normalised coordinates."""

MAX_AXIS_RATIO = 10.0
"""Longest semi-axis over the shortest of a region that is rendered."""


def renderable(covariance: Tensor) -> Tensor:
    """Clamp the eigenvalues of covariances (..., 2, 2) so that warping by them stays finite.

    Eigenvalues are at least `MIN_AXIS^2` and at least the larger one over `MAX_AXIS_RATIO^2`;
    covariances within these bounds are unchanged.
    """
    a, b, d = covariance[..., 0, 0], covariance[..., 0, 1], covariance[..., 1, 1]
    gap = torch.sqrt(((a - d) / 2) ** 2 + b**2)
    major, minor = (a + d) / 2 + gap, (a + d) / 2 - gap
    wanted_major = major.clamp_min(MIN_AXIS**2)
    wanted_minor = torch.maximum(minor, wanted_major / MAX_AXIS_RATIO**2).clamp_min(MIN_AXIS**2)
    # with equal eigenvalues any split of the sum is right: the traceless part is zero
    stretch = torch.where(gap > 0, (wanted_major - wanted_minor) / (2 * gap.clamp_min(1e-12)), 1.0)
    identity = torch.eye(2, device=covariance.device)
    traceless = covariance - ((a + d) / 2)[..., None, None] * identity
    middle = ((wanted_major + wanted_minor) / 2)[..., None, None] * identity
    return middle + stretch[..., None, None] * traceless


def renderable_affine(affine: Tensor) -> Tensor:
    """Clamp the semi-axes of affines (..., 2, 2) as `renderable` clamps those of `A A^T`.

    Of `A = U s V^T` U and V stay; affines within the bounds are unchanged.
    """
    covariance = affine @ affine.mT
    clamped = renderable(covariance)
    unit = F.normalize(affine_from_covariance(covariance), dim=-2)  # columns: the axes
    axes = unit * (unit.mT @ clamped @ unit).diagonal(dim1=-2, dim2=-1).sqrt()[..., None, :]
    first = (unit[..., :, :1].mT @ affine)[..., 0, :]  # along the first row of V^T
    length = torch.linalg.vector_norm(first, dim=-1, keepdim=True)
    across = torch.tensor([1.0, 0.0], device=affine.device)
    first = torch.where(length > 0, first / length, across)
    a, b, c, d = affine.flatten(-2).unbind(-1)
    side = torch.where(a * d < b * c, -1.0, 1.0)[..., None]
    second = side * torch.stack([-first[..., 1], first[..., 0]], dim=-1)
    scaled = axes @ torch.stack([first, second], dim=-2)
    outside = (clamped - covariance).abs().amax((-2, -1), keepdim=True) > 1e-3 * MIN_AXIS**2
    return torch.where(outside, scaled, affine)


EPSILON = 1e-5
"""Smallest diagonal entry of a Cholesky factor (ANGIE, section 3.2: ReLU + 1e-5)."""


def encode_cholesky(covariance: Tensor) -> Tensor:
    """Lower Cholesky factors of 2x2 covariances in closed form.

    For C = [[a, b], [b, d]]: l1 = sqrt(a), l2 = b / l1, l3 = sqrt(d - l2^2), computed in float32.
    The floor on C itself belongs to the region estimator; here only the roots are kept real.

    Args:
        covariance: (..., 2, 2) symmetric positive definite.

    Returns:
        (..., 3) float32, (l1, l2, l3) with l1, l3 >= 1e-5.
    """
    covariance = covariance.float()
    a, b, d = covariance[..., 0, 0], covariance[..., 1, 0], covariance[..., 1, 1]
    l1 = a.clamp_min(EPSILON**2).sqrt()
    l2 = b / l1
    l3 = (d - l2.square()).clamp_min(EPSILON**2).sqrt()
    return torch.stack([l1, l2, l3], dim=-1)


def decode_cholesky(cholesky: Tensor) -> Tensor:
    """Covariances L L^T of Cholesky factors.

    Args:
        cholesky: (..., 3) float32, (l1, l2, l3).

    Returns:
        (..., 2, 2) float32, symmetric.
    """
    l1, l2, l3 = cholesky.float().unbind(-1)
    off = l1 * l2
    rows = torch.stack([l1.square(), off, off, l2.square() + l3.square()], dim=-1)
    return rows.unflatten(-1, (2, 2))


def cholesky(covariance: Tensor) -> Tensor:
    """Lower factors (..., 2, 2) of covariances (..., 2, 2), as `encode_cholesky` gives them."""
    l1, l2, l3 = encode_cholesky(covariance).unbind(-1)
    return torch.stack([l1, torch.zeros_like(l1), l2, l3], dim=-1).unflatten(-1, (2, 2))


ROOTS = {"svd": _eigen_root, "lapack": _lapack_root, "sym": _symmetric_root, "chol": cholesky}
"""Ways to take the root of a covariance."""

WITH_AXES = ("svd", "lapack")
"""Those whose columns are the axes of the region, up to order and sign."""


def affine_from_covariance(covariance: Tensor, mode: str = "svd") -> Tensor:
    """A root A of the covariance, `A A^T = C`: the region's local affine frame.

    Args:
        covariance: (..., 2, 2) symmetric positive definite, float32.
        mode: "svd" `U sqrt(S)` with det U = 1 (MRAA), "lapack" the same with the signs that
            the released weights were trained with (det U = -1), "sym" the symmetric root, "chol"
            the Cholesky factor; the last two are continuous but do not follow rotations.

    Returns:
        (..., 2, 2) float32.
    """
    return ROOTS[mode](covariance.float())


def relative_affine(source: Tensor, driving: Tensor, *, revert_axis_swap: bool) -> Tensor:
    """`A_s A_d^-1`, the map from driving to source around a region.

    Args:
        source: (..., 2, 2) affine of the source.
        driving: (..., 2, 2) affine of the driving.
        revert_axis_swap: multiply by the sign of the (0, 0) entry (MRAA), which removes the
            joint sign that the eigenvectors leave open.
    """
    product = source @ inverse(driving)
    return fix_sign(product) if revert_axis_swap else product


def track_axes(affine: Tensor, start: Tensor) -> Tensor:
    """Follow the axes of regions over time, so that no frame jumps where C moves smoothly.

    An eigen root leaves the sign of its columns and, where the axes have been equally long,
    their order open: `A`, `-A`, `[a2, -a1]` and `[-a2, a1]` have the same `A A^T`. Each frame
    takes the one closest to the frame before (in the sum of squares), the first the one closest
    to `start`. Such axes need no sign fix, which would undo turns by more than 90 degrees.

    Where a region is round its axes mean nothing: a frame there may still jump by up to 45
    degrees, and a region that goes once around the round shape comes back as `-A`.

    Args:
        affine: (T, ..., 2, 2) of T frames in order.
        start: (..., 2, 2) of the frame before, or of the source.

    Returns:
        (T, ..., 2, 2), the same covariances.
    """
    before = torch.cat([start[None], affine[:-1]])
    swapped = torch.stack([affine[..., 1], -affine[..., 0]], dim=-1)
    # all four have one norm: the closest has the largest inner product, and a choice made for
    # one frame turns those of all later ones, so that quarter turns add up
    same, quarter = ((x * before).sum((-2, -1)) for x in (affine, swapped))
    turns = torch.stack([same, quarter, -same, -quarter]).argmax(0).cumsum(0) % 4
    turned = torch.where((turns % 2 == 1)[..., None, None], swapped, affine)
    return torch.where((turns >= 2)[..., None, None], -turned, turned)


def fix_sign(matrix: Tensor) -> Tensor:
    """Multiply (..., 2, 2) matrices by the sign of their (0, 0) entry."""
    return matrix * torch.sign(matrix[..., :1, :1])
