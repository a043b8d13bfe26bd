"""Rewritten convolutions give what the plain ones give."""

import torch
import torch.nn.functional as F
from torch import nn

from mraa.fast.folding import PHASES, Kernel, blocks, columns, doubling, fold, stacked


def kernel(outputs, inputs, size):
    random = torch.Generator().manual_seed(size)
    weight = torch.randn(outputs, inputs, size, size, generator=random)
    return Kernel(weight, torch.randn(outputs, generator=random))


def test_a_norm_folds():
    conv, norm = nn.Conv2d(3, 4, 3), nn.BatchNorm2d(4)
    for x in (norm.weight, norm.bias, norm.running_mean):
        nn.init.normal_(x)
    nn.init.uniform_(norm.running_var, 0.5, 2)
    image = torch.randn(2, 3, 8, 8, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        wanted = norm.eval()(conv(image))
    one = fold(conv, norm)
    torch.testing.assert_close(F.conv2d(image, one.weight, one.bias), wanted)


def test_doubling_before_the_convolution():
    one = kernel(5, 3, 3)
    image = torch.randn(2, 3, 4, 6, generator=torch.Generator().manual_seed(0))
    wanted = F.conv2d(F.interpolate(image, scale_factor=2.0), one.weight, one.bias, padding=1)
    four = doubling(one)
    found = F.conv2d(image, four.weight, four.bias, padding=1)
    assert found.shape == (2, 20, 5, 7)
    for phase, (i, j) in enumerate(PHASES):
        part = found[:, 5 * phase : 5 * phase + 5, i : i + 4, j : j + 6]
        torch.testing.assert_close(part, wanted[:, :, i::2, j::2])


def test_blocks_of_pixels():
    one = kernel(3, 4, 7)
    image = torch.randn(2, 4, 8, 10, generator=torch.Generator().manual_seed(0))
    wanted = F.conv2d(image, one.weight, one.bias, padding=3)
    four = blocks(one)
    found = F.conv2d(image, four.weight, four.bias, stride=2, padding=3)
    torch.testing.assert_close(F.pixel_shuffle(found, 2), wanted)


def test_stacked_kernels_see_one_input():
    first, second = kernel(2, 3, 3), kernel(1, 3, 3)
    both = stacked(first, second)
    image = torch.randn(1, 3, 5, 5, generator=torch.Generator().manual_seed(0))
    found = F.conv2d(image, both.weight, both.bias)
    torch.testing.assert_close(found[:, 2:], F.conv2d(image, second.weight, second.bias))


def test_columns_side_by_side():
    one = kernel(3, 4, 7)
    image = torch.randn(2, 4, 8, 10, generator=torch.Generator().manual_seed(0))
    wanted = F.conv2d(image, one.weight, one.bias, padding=3)
    apart = columns(one)
    parts = F.conv2d(image, apart.weight, apart.bias, padding=(3, 0)).chunk(7, dim=1)
    found = torch.zeros_like(wanted)
    for j, part in enumerate(parts):
        for x in range(10):
            if 0 <= x + j - 3 < 10:
                found[..., x] += part[..., x + j - 3]
    torch.testing.assert_close(found, wanted)
