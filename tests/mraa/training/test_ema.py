import pytest
import torch
from torch import nn

from mraa.training.checkpoint import AveragedModel


def test_the_average_of_hand_worked_updates():
    model = nn.BatchNorm1d(1, affine=False)
    model.running_mean.fill_(0.0)
    average = AveragedModel(model, 0.25)
    model.running_mean.fill_(1.0)
    model.num_batches_tracked.fill_(7)
    average.update(model)  # decay (1 + 1) / (10 + 1)
    assert average.model.running_mean.item() == pytest.approx(1 - 2 / 11)
    assert average.model.num_batches_tracked == 7
    average.update(model)  # decay 0.25, since 3 / 12 is no less
    assert average.model.running_mean.item() == pytest.approx(1 - 0.25 * 2 / 11)
    average.update(model)  # 4 / 13 is more than 0.25
    assert average.model.running_mean.item() == pytest.approx(1 - 0.25**2 * 2 / 11)


def test_state_is_kept_and_the_copy_never_learns():
    model = nn.Linear(2, 2)
    average = AveragedModel(model, 0.9)
    assert not any(p.requires_grad for p in average.parameters())
    with torch.no_grad():
        model.weight.add_(1)
    average.update(model)
    again = AveragedModel(model, 0.9)
    again.load_state_dict(average.state_dict())
    assert again.updates == 1
    assert torch.equal(again.model.weight, average.model.weight)
    assert not torch.equal(average.model.weight, model.weight)
