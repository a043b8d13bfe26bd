import numpy as np
import pytest
import torch
from torch import nn

from data_prep.errors import BadInput
from mraa.run import Run, RunConfig


class Numbers:
    def __len__(self):
        return 7

    def draw(self, index, random):
        return torch.tensor([index, random.random()], dtype=torch.float32)


def work(folder, steps, resume=False, width=4, identity=""):
    """A few steps of a network whose dropout and data are random."""
    config = RunConfig(device="cpu", log_every=1, identity=identity)
    run = Run(folder, "toy", steps=steps, seed=3, resume=resume, config=config)
    torch.manual_seed(0)
    model = nn.Sequential(nn.Linear(2, width), nn.BatchNorm1d(width), nn.Dropout(0.5))
    model, optimizer = run.setup(model, torch.optim.Adam(model.parameters(), lr=0.1))
    batches = run.batches(Numbers(), batch_size=4)
    model.train()
    seen, losses = [], []
    for _ in run.steps():
        run.rate(optimizer, 0.1, [6])
        batch = next(batches)
        loss = (model(batch) - batch.sum()).square().mean()
        run.backward(loss)
        optimizer.step()
        optimizer.zero_grad()
        run.log(loss=loss)
        seen.append(batch.clone())
        losses.append(loss.item())
    return model.state_dict(), seen, losses


def test_resumed_training_is_the_uninterrupted_one_bit_for_bit(tmp_path):
    whole, seen, losses = work(tmp_path / "whole", 10)
    work(tmp_path / "parts", 4)
    resumed, rest, late = work(tmp_path / "parts", 10, resume=True)
    assert losses[4:] == late
    assert all(torch.equal(a, b) for a, b in zip(seen[4:], rest, strict=True))
    assert whole.keys() == resumed.keys()
    assert all(torch.equal(whole[k], resumed[k]) for k in whole)


def test_without_resume_it_starts_anew(tmp_path):
    _, _, first = work(tmp_path, 3)
    _, _, again = work(tmp_path, 3)
    assert first == again and len(again) == 3


def test_an_epoch_meets_every_item_once(tmp_path):
    _, seen, _ = work(tmp_path, 7)
    items = np.concatenate([batch[:, 0].numpy() for batch in seen]).astype(int)
    for epoch in range(4):
        assert sorted(items[epoch * 7 : (epoch + 1) * 7]) == list(range(7))
    assert list(items[:7]) != list(items[7:14])


def test_a_checkpoint_of_another_architecture_is_refused(tmp_path):
    work(tmp_path, 2)
    with pytest.raises(BadInput, match="another architecture"):
        work(tmp_path, 4, resume=True, width=5)


def test_a_checkpoint_of_other_data_is_not_resumed(tmp_path):
    _, _, first = work(tmp_path, 4, identity="one")
    _, _, other = work(tmp_path, 4, resume=True, identity="two")
    assert other == first  # all four steps again
    _, _, same = work(tmp_path, 6, resume=True, identity="two")
    assert len(same) == 2


def test_a_damaged_checkpoint_is_refused(tmp_path):
    work(tmp_path, 2)
    path = tmp_path / "toy.safetensors"
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(BadInput, match="damaged"):
        work(tmp_path, 4, resume=True)


def test_curves_are_written(tmp_path):
    work(tmp_path, 2)
    assert list((tmp_path / "curves" / "toy").glob("events*"))
