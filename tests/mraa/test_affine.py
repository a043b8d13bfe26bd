import math

import pytest
import torch

from mraa.affine import (
    MAX_AXIS_RATIO,
    MIN_AXIS,
    affine_from_covariance,
    fix_sign,
    inverse,
    relative_affine,
    renderable,
)


def random_covariance(count=200):
    generator = torch.Generator().manual_seed(0)
    root = torch.randn(count, 2, 2, generator=generator) * 0.2
    return root @ root.mT + 1e-3 * torch.eye(2)


@pytest.mark.parametrize("mode", ["svd", "sym", "chol"])
def test_affine_is_a_root_of_the_covariance(mode):
    covariance = random_covariance()
    root = affine_from_covariance(covariance, mode)
    torch.testing.assert_close(root @ root.mT, covariance, atol=1e-6, rtol=0)


def test_svd_axes_of_a_known_ellipse():
    angle = math.radians(30)
    turn = torch.tensor([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    covariance = turn @ torch.diag(torch.tensor([0.09, 0.01])) @ turn.T
    wanted = turn @ torch.diag(torch.tensor([0.3, 0.1]))
    torch.testing.assert_close(affine_from_covariance(covariance), wanted, atol=1e-6, rtol=0)


@pytest.mark.parametrize("mode", ["svd", "sym", "chol"])
def test_gradients_stay_finite_for_round_regions(mode):
    for gap in (0.0, 1e-7, 1e-4, 1e-2):
        covariance = torch.diag(torch.tensor([0.01 * (1 + gap), 0.01])).requires_grad_()
        affine_from_covariance(covariance, mode).sum().backward()
        assert torch.isfinite(covariance.grad).all()
        assert covariance.grad.abs().max() < 1e4


def test_svd_gradient_is_exact_for_long_regions():
    covariance = torch.tensor([[0.09, 0.02], [0.02, 0.01]])
    ours = covariance.clone().requires_grad_()
    affine_from_covariance(ours)[0, 1].backward()
    step = 1e-3
    bumped = covariance + torch.tensor([[step, 0.0], [0.0, 0.0]])
    slope = (affine_from_covariance(bumped) - affine_from_covariance(covariance))[0, 1] / step
    assert float(ours.grad[0, 0]) == pytest.approx(float(slope), rel=0.05)


def test_inverse_and_sign_fix():
    matrix = torch.tensor([[2.0, 1.0], [3.0, 4.0]])
    torch.testing.assert_close(inverse(matrix), torch.tensor([[0.8, -0.2], [-0.6, 0.4]]))
    torch.testing.assert_close(fix_sign(-matrix), matrix)
    same = relative_affine(-matrix, matrix, revert_axis_swap=True)
    torch.testing.assert_close(same, torch.eye(2))


def test_renderable_leaves_good_covariances_alone():
    covariance = torch.tensor([[[0.04, 0.01], [0.01, 0.02]], [[0.01, 0.0], [0.0, 0.01]]])
    torch.testing.assert_close(renderable(covariance), covariance)


def test_renderable_clamps_axes_and_their_ratio():
    covariance = torch.stack([torch.zeros(2, 2), torch.diag(torch.tensor([0.25, 1e-8]))])
    eigenvalues = torch.linalg.eigvalsh(renderable(covariance))
    torch.testing.assert_close(eigenvalues[0], torch.full((2,), MIN_AXIS**2))
    wanted = torch.tensor([0.25 / MAX_AXIS_RATIO**2, 0.25])
    torch.testing.assert_close(eigenvalues[1], wanted)
