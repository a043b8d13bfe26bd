import copy

import pytest
import torch
from torch import nn

from mraa.training.renderer import moving_average


def test_the_average_of_hand_worked_updates():
    model = nn.BatchNorm1d(1, affine=False)
    model.running_mean.fill_(0.0)
    average = moving_average(model, 0.25)
    model.running_mean.fill_(1.0)
    model.num_batches_tracked.fill_(7)
    average.update_parameters(model)  # keeps (1 + 1) / (10 + 1)
    assert average.module.running_mean.item() == pytest.approx(1 - 2 / 11)
    assert average.module.num_batches_tracked == 7
    average.update_parameters(model)  # keeps 0.25, since 3 / 12 is no less
    assert average.module.running_mean.item() == pytest.approx(1 - 0.25 * 2 / 11)
    average.update_parameters(model)  # 4 / 13 is more than 0.25
    assert average.module.running_mean.item() == pytest.approx(1 - 0.25**2 * 2 / 11)


def test_weights_are_averaged_and_the_state_goes_on():
    torch.manual_seed(0)
    model = nn.Linear(3, 2)
    average = moving_average(model, 0.3)
    assert not any(p.requires_grad for p in average.parameters())
    wanted = copy.deepcopy(model.weight.detach())
    for update in range(1, 21):
        with torch.no_grad():
            model.weight.normal_()
        kept = min(0.3, (1 + update) / (10 + update))
        wanted = kept * wanted + (1 - kept) * model.weight.detach()
        average.update_parameters(model)
        if update == 10:  # as if resumed
            again = moving_average(nn.Linear(3, 2), 0.3)
            again.load_state_dict(average.state_dict())
            average = again
    torch.testing.assert_close(average.module.weight, wanted, atol=1e-6, rtol=0)
