"""Minimal filtering gives what a convolution gives."""

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from mraa.fast.folding import Kernel
from mraa.fast.winograd import Winograd, fits, joined, split


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
    down = np.array([1 / 4, -1 / 6, -1 / 6, 1 / 24, 1 / 24, 0])  # G times (1, 0, 0)
    across = np.array([1, 1 / 2, 1 / 2, 0])
    found = Winograd(Kernel(weight, torch.zeros(1))).matrices.reshape(6, 4)
    np.testing.assert_allclose(found, np.outer(down, across), atol=1e-7)


def test_bfloat16_loses_about_a_hundredth():
    x, kernel = make(inputs=64, outputs=64)
    x = x.bfloat16()
    wanted = F.conv2d(x.double(), kernel.weight.double(), kernel.bias.double(), padding=1)
    found = Winograd(kernel, dtype=torch.bfloat16, relu=False)(x)
    assert found.dtype == torch.bfloat16
    assert 1e-3 < error(found, wanted) < 0.02


def test_lines_hold_zeros_around_every_frame():
    x = torch.arange(1.0, 17.0).reshape(2, 1, 2, 4)
    lines = split(x)
    assert lines[..., 0].tolist() == [
        [[0, 0, 0], [0, 0, 0]],
        [[0, 2, 4], [1, 3, 0]],
        [[0, 6, 8], [5, 7, 0]],
        [[0, 0, 0], [0, 0, 0]],
        [[0, 10, 12], [9, 11, 0]],
        [[0, 14, 16], [13, 15, 0]],
        [[0, 0, 0], [0, 0, 0]],
    ]
    assert torch.equal(joined(lines, 2), x)


def test_only_shapes_that_it_can_do():
    _, kernel = make(64, 64)
    assert fits(kernel, (1, 64, 64, 62))
    assert not fits(kernel, (1, 64, 62, 64))
    assert not fits(kernel, (1, 64, 64, 63))
    assert not fits(kernel, (1, 64, 8, 8))
    assert not fits(make(64, 16)[1], (1, 64, 64, 64))
    assert not fits(Kernel(torch.zeros(64, 64, 5, 5), torch.zeros(64)), (1, 64, 64, 64))
