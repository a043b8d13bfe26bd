import torch
import torch.distributed as dist
from torch import nn

from mraa.training.devices import SyncNorm, synchronise


class Both:
    """Stands for two processes that hold the same share: every sum doubles."""

    def __init__(self, monkeypatch):
        monkeypatch.setattr(dist, "all_reduce", lambda x: x.mul_(2))
        monkeypatch.setattr(dist, "get_world_size", lambda: 2)


def test_two_equal_shares_are_normalised_as_the_batch_of_both(monkeypatch):
    Both(monkeypatch)
    torch.manual_seed(0)
    share = torch.randn(3, 5, 4, 4, requires_grad=True)
    plain, synced = nn.BatchNorm2d(5), nn.Sequential(nn.BatchNorm2d(5))
    with torch.no_grad():
        plain.weight.uniform_(0.5, 2)
        plain.bias.normal_()
    synced.load_state_dict({f"0.{k}": v for k, v in plain.state_dict().items()})
    synchronise(synced)
    assert isinstance(synced[0], SyncNorm)
    batch = torch.cat([share, share]).detach().requires_grad_()
    weight = torch.randn(3, 5, 4, 4)
    (plain(batch) * torch.cat([weight, weight])).sum().backward()
    (synced(share) * weight).sum().backward()
    torch.testing.assert_close(synced(share), plain(batch)[:3])
    # each process's gradient is that of the sum over both, as DDP wants it
    torch.testing.assert_close(share.grad, batch.grad[:3], atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(2 * synced[0].weight.grad, plain.weight.grad)
    torch.testing.assert_close(synced[0].running_var, plain.running_var)
    torch.testing.assert_close(synced[0].running_mean, plain.running_mean)
    assert synced[0].num_batches_tracked == plain.num_batches_tracked


def test_names_parameters_and_evaluation_stay():
    torch.manual_seed(0)
    model = nn.Sequential(nn.Conv2d(3, 4, 1), nn.BatchNorm2d(4))
    model(torch.randn(2, 3, 4, 4))
    before = model.state_dict()
    parameters = list(model.parameters())
    model.eval()
    image = torch.randn(1, 3, 4, 4)
    wanted = model(image)
    synchronise(model)
    assert list(model.state_dict()) == list(before)
    assert all(a is b for a, b in zip(model.parameters(), parameters, strict=True))
    assert torch.equal(model(image), wanted)
