"""Changes of colours for the equivariance losses."""

import torch

from mraa.transform import TINT_NUMBERS, tint


def test_a_tint_is_one_matrix_and_one_offset():
    image = torch.rand(1, 3, 4, 5)
    noise = torch.zeros(1, TINT_NUMBERS)
    torch.testing.assert_close(tint(image, noise, 0.5), image)
    noise[0, 1] = 1  # red into green
    mixed = tint(image, noise, 0.5)
    green = image[:, 1] + 0.5 * (image[:, 0] - 0.5)
    torch.testing.assert_close(mixed[:, 1], green.clamp(0, 1))
    torch.testing.assert_close(mixed[:, ::2], image[:, ::2])
    noise = torch.zeros(1, TINT_NUMBERS)
    noise[0, 11] = 0.4  # more blue
    torch.testing.assert_close(tint(image, noise, 0.5)[:, 2], (image[:, 2] + 0.1).clamp(max=1))


def test_no_amount_is_no_change_and_colours_stay_in_range():
    torch.manual_seed(0)
    image, noise = torch.rand(3, 3, 8, 8), torch.randn(3, TINT_NUMBERS)
    torch.testing.assert_close(tint(image, noise, 0.0), image)
    changed = tint(image, noise, 2.0)
    assert changed.min() == 0 and changed.max() == 1
    assert (changed[0] - tint(image, noise.flip(0), 2.0)[0]).abs().mean() > 0.05
