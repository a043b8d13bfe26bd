"""Minimal filtering gives what a convolution gives."""

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from mraa.fast.folding import Kernel
from mraa.fast.winograd import Winograd, fits, transformed_kernel


def make(inputs=32, outputs=48, height=8, width=12, count=3):
    random = torch.Generator().manual_seed(0)
    x = torch.randn(count, inputs, height, width, generator=random)
    weight = torch.randn(outputs, inputs, 3, 3, generator=random) / inputs**0.5
    kernel = Kernel(weight, torch.randn(outputs, generator=random))
    return x.to(memory_format=torch.channels_last), kernel


def error(found, wanted):
    return float((found.double() - wanted).square().mean().sqrt() / wanted.std())


@pytest.mark.parametrize("relu", [True, False])
def test_is_the_convolution(relu):
    x, kernel = make()
    wanted = F.conv2d(x.double(), kernel.weight.double(), kernel.bias.double(), padding=1)
    found = Winograd(kernel, relu=relu)(x)
    assert found.is_contiguous(memory_format=torch.channels_last)
    assert error(found, wanted.relu() if relu else wanted) < 5e-6


def test_line_before_and_residual_behind():
    x, kernel = make(outputs=32)
    scale, shift = torch.linspace(-1, 1, 32), torch.linspace(0.5, -0.5, 32)
    before = (x.double() * scale[:, None, None] + shift[:, None, None]).relu()
    wanted = F.conv2d(before, kernel.weight.double(), kernel.bias.double(), padding=1) + x.double()
    convolution = Winograd(kernel, scale_shift=(scale, shift))
    found = convolution(x, x)
    assert error(found, wanted.relu()) < 5e-6


def test_more_tiles_than_are_taken_at_once():
    x, kernel = make(inputs=16, outputs=16, height=64, width=64, count=1)
    wanted = F.conv2d(x.double(), kernel.weight.double(), kernel.bias.double(), padding=1)
    assert error(Winograd(kernel, relu=False)(x), wanted) < 5e-6


def test_kernel_of_one_tap():
    weight = torch.zeros(1, 1, 3, 3)
    weight[0, 0, 0, 0] = 1
    column = np.array([1 / 4, -1 / 6, -1 / 6, 1 / 24, 1 / 24, 0])  # G times (1, 0, 0)
    wanted = np.outer(column, column)
    np.testing.assert_allclose(transformed_kernel(weight, 4).reshape(6, 6), wanted, atol=1e-7)


def test_only_shapes_that_it_can_do():
    _, kernel = make(64, 64)
    single = torch.float32
    assert fits(kernel, (1, 64, 64, 64), single)
    assert not fits(kernel, (1, 64, 64, 64), torch.bfloat16)
    assert not fits(kernel, (1, 64, 62, 64), single)
    assert fits(Kernel(torch.zeros(64, 64, 2, 2), torch.zeros(64)), (1, 64, 62, 64), single)
    assert not fits(make(60, 64)[1], (1, 60, 64, 64), single)
    assert not fits(Kernel(torch.zeros(64, 64, 5, 5), torch.zeros(64)), (1, 64, 64, 64), single)


def test_kernels_of_two():
    x, _ = make(height=8, width=13)
    random = torch.Generator().manual_seed(1)
    kernel = Kernel(torch.randn(16, 32, 2, 2, generator=random) / 8, torch.randn(16))
    wanted = F.conv2d(x.double(), kernel.weight.double(), kernel.bias.double(), padding=1).relu()
    found = Winograd(kernel)(x)
    assert wanted.shape[2:] == (9, 14) and found.shape[2:] == (9, 15)
    assert error(found[..., :14], wanted) < 5e-6
