import json

import numpy as np
import pytest
import torch
from lightning_fabric.plugins.precision import MixedPrecision
from safetensors import safe_open
from safetensors.torch import save_file
from torch import nn

from data_prep.errors import BadInput
from mraa.training.batches import StepSampler
from mraa.training.checkpoint import Checkpoint, save_checkpoint
from mraa.training.run import Run, RunConfig


class Numbers:
    def __len__(self):
        return 7

    def draw(self, index, random):
        return torch.tensor([index, random.random()], dtype=torch.float32)


def open_run(folder, steps, resume=False, identity="", scaled=False, growth=3):
    config = RunConfig(device="cpu", log_every=1, identity=identity)
    run = Run(folder, "toy", steps=steps, seed=3, resume=resume, config=config)
    if scaled:  # what 16-bit training does on a GPU
        scaler = torch.amp.GradScaler("cpu", init_scale=1024.0, growth_interval=growth)
        run.fabric.strategy.precision = MixedPrecision("16-mixed", "cpu", scaler)
    torch.manual_seed(0)
    return run


def work(folder, steps, resume=False, width=4, identity="", scaled=False):
    """A few steps of a network whose dropout and data are random."""
    run = open_run(folder, steps, resume, identity, scaled)
    toy = nn.Sequential(nn.Linear(2, width), nn.BatchNorm1d(width), nn.Dropout(0.5))
    model = run.add("toy", toy, torch.optim.Adam(toy.parameters(), lr=0.1), [6])
    batches = run.batches(Numbers(), batch_size=4)
    seen, losses = [], []
    for _ in run.steps():
        batch = next(batches)
        loss = (model(batch) - batch.sum()).square().mean()
        run.update(loss, "toy")
        run.log(loss=loss)
        seen.append(batch.clone())
        losses.append(loss.item())
    return toy.state_dict(), seen, losses


@pytest.mark.parametrize("scaled", [False, True])
def test_resumed_training_is_the_uninterrupted_one_bit_for_bit(tmp_path, scaled):
    stop = int(torch.randint(1, 10, ()))
    whole, seen, losses = work(tmp_path / "whole", 10, scaled=scaled)
    work(tmp_path / "parts", stop, scaled=scaled)
    resumed, rest, late = work(tmp_path / "parts", 10, resume=True, scaled=scaled)
    assert losses[stop:] == late
    assert all(torch.equal(a, b) for a, b in zip(seen[stop:], rest, strict=True))
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
    _, _, losses = work(tmp_path, 2)
    lines = (tmp_path / "curves" / "toy.csv").read_text().splitlines()
    assert [float(line.split(",")[2]) for line in lines[1:]] == pytest.approx(losses)


def test_the_scale_of_16_bit_training_is_resumed(tmp_path):
    work(tmp_path, 7, scaled=True)
    with safe_open(tmp_path / "toy.safetensors", framework="pt") as file:
        state = json.loads(file.metadata()["scaler"])
    assert state["scale"] == 4096 and state["_growth_tracker"] == 1  # grew twice in 7 steps


def test_a_batch_in_parts_has_the_items_and_the_gradient_of_the_whole(tmp_path):
    def train(parts):
        run = Run(tmp_path / str(parts), "toy", steps=3, config=RunConfig(device="cpu"))
        torch.manual_seed(0)
        linear = nn.Linear(2, 1)
        model = run.add("toy", linear, torch.optim.SGD(linear.parameters(), lr=0.1))
        batches = run.batches(Numbers(), 4, parts)
        seen = []
        for _ in run.steps():
            for _ in run.parts(parts, "toy"):
                batch = next(batches)
                loss = model(batch).square().mean()
                run.update(loss, "toy")
                run.log(loss=loss)
                seen.append(batch)
        table = (tmp_path / str(parts) / "curves" / "toy.csv").read_text().splitlines()[1:]
        return linear.weight, torch.cat(seen), [float(row.split(",")[2]) for row in table]

    whole, items, losses = train(1)
    parts, same, means = train(2)
    assert torch.equal(items, same)
    torch.testing.assert_close(whole, parts)
    assert losses == pytest.approx(means)
    with pytest.raises(BadInput, match="does not divide"):
        next(Run(tmp_path, "toy", steps=1).batches(Numbers(), 4, 3))


def test_what_a_process_loads_is_its_share_of_the_step(tmp_path):
    def items(rank, world, parts):
        batches = iter(StepSampler(7, 8, 3, 2, rank, world, parts))
        return [item for _ in range(parts) for item in next(batches)]

    whole = items(0, 1, 1)
    for parts in (1, 2):
        shares = [items(rank, 2, parts) for rank in (0, 1)]
        assert sorted(shares[0] + shares[1]) == sorted(whole)
        assert shares[0] == whole[::2]


def test_a_fused_optimiser_goes_on_with_kernels_of_any_layout(tmp_path):
    """Files hold tensors row by row; channels-last weights want their moments channels last."""

    def made():
        torch.manual_seed(0)
        model = nn.Conv2d(3, 4, 3).to(memory_format=torch.channels_last)
        return model, torch.optim.Adam(model.parameters(), lr=0.1, fused=True)

    def step(model, optimizer, seed):
        torch.manual_seed(seed)
        model(torch.randn(1, 3, 5, 5)).square().sum().backward()
        optimizer.step()
        optimizer.zero_grad()

    model, optimizer = made()
    step(model, optimizer, 1)
    save_checkpoint(tmp_path / "a.safetensors", {"toy": model}, {"toy": optimizer}, 1)
    again, fresh = made()
    Checkpoint(tmp_path / "a.safetensors").restore("toy", again, fresh)
    step(model, optimizer, 2)
    step(again, fresh, 2)
    assert torch.equal(model.weight, again.weight)


def adversaries(folder, steps, resume=False, scaled=False):
    """Two networks with an optimiser each, one loss through both, and a slow copy of one."""
    run = open_run(folder, steps, resume, scaled=scaled)
    maker, judge, slow = nn.Linear(2, 2), nn.Linear(2, 1), nn.Linear(2, 2)
    slow.load_state_dict(maker.state_dict())
    made = run.add("maker", maker, torch.optim.Adam(maker.parameters(), lr=0.1))
    judged = run.add("judge", judge, torch.optim.SGD(judge.parameters(), lr=0.01), [2])
    copied = run.add("slow", slow)
    batches = run.batches(Numbers(), batch_size=4)
    for _ in run.steps():
        batch = next(batches)
        run.update((judged(made(batch)) - judged(batch)).square().mean(), "judge", clip=0.5)
        assert all(p.grad is None for p in (*maker.parameters(), *judge.parameters()))
        run.update((judged(made(batch)) - copied(batch)).square().mean(), "maker", clip=0.5)
        run.update((judged(made(batch)) - 1).square().mean(), "maker", "judge")
        with torch.no_grad():
            for mean, value in zip(slow.parameters(), maker.parameters(), strict=True):
                mean.lerp_(value, 0.1)
        run.keep_best(float(maker.weight.detach().sum()), 0, "maker")
    run.restore_best()
    return [p.detach().clone() for model in (maker, judge, slow) for p in model.parameters()]


@pytest.mark.parametrize("scaled", [False, True])
def test_several_models_and_optimisers_resume_bit_for_bit(tmp_path, scaled):
    whole = adversaries(tmp_path / "whole", 7, scaled=scaled)
    adversaries(tmp_path / "parts", 3, scaled=scaled)
    parts = adversaries(tmp_path / "parts", 7, resume=True, scaled=scaled)
    assert all(torch.equal(a, b) for a, b in zip(whole, parts, strict=True))


def test_only_the_models_named_get_gradients(tmp_path):
    run = open_run(tmp_path, 1)
    first, second = nn.Linear(1, 1, bias=False), nn.Linear(1, 1, bias=False)
    for name, model, weight in (("first", first, 2.0), ("second", second, 3.0)):
        nn.init.constant_(model.weight, weight)
        run.add(name, model, torch.optim.SGD(model.parameters(), lr=1.0))
    for _ in run.steps():
        run.update(second(first(torch.ones(1, 1))).sum(), "first", clip=1.0)
    assert first.weight.item() == pytest.approx(2 - 1)  # the gradient 3 clipped to norm 1
    assert second.weight.item() == 3
    with pytest.raises(ValueError, match="no dot"):
        run.add("first", nn.Linear(1, 1))


@pytest.mark.parametrize("scaled", [False, True])
def test_one_loss_moves_several_models_under_one_scale(tmp_path, scaled):
    """A scale that grew between the two optimisers would halve the second one's step."""
    run = open_run(tmp_path, 1, scaled=scaled, growth=1)
    first, second = nn.Linear(1, 1, bias=False), nn.Linear(1, 1, bias=False)
    for name, model, weight in (("first", first, 2.0), ("second", second, 3.0)):
        nn.init.constant_(model.weight, weight)
        run.add(name, model, torch.optim.SGD(model.parameters(), lr=1.0))
    for _ in run.steps():
        run.update(second(first(torch.ones(1, 1))).sum(), "first", "second")
    assert first.weight.item() == 2 - 3 and second.weight.item() == 3 - 2


def scored(folder, scores, patience, resume=False, steps=None):
    """Weights step + 1 of a network whose scores are given; what is left of them."""
    run = open_run(folder, steps or len(scores), resume)
    toy = nn.Linear(1, 1)
    run.add("toy", toy, torch.optim.SGD(toy.parameters(), lr=0.1))
    done = []
    for step in run.steps():
        nn.init.constant_(toy.weight, step + 1)
        run.keep_best(scores[step], patience)
        run.log(loss=0.0)
        done.append(step)
    run.restore_best()
    return toy.weight.item(), done


def test_the_best_weights_are_kept_and_training_ends_without_improvement(tmp_path):
    scores = [3.0, 1.0, 2.0, 4.0, 0.0]
    assert scored(tmp_path / "whole", scores, 2) == (2.0, [0, 1, 2, 3])
    assert scored(tmp_path / "parts", scores, 2, steps=3) == (2.0, [0, 1, 2])
    assert scored(tmp_path / "parts", scores, 2, resume=True) == (2.0, [3])
    assert scored(tmp_path / "parts", scores, 2, resume=True) == (2.0, [])
    assert scored(tmp_path / "all", scores, 0) == (5.0, [0, 1, 2, 3, 4])
    rows = (tmp_path / "whole" / "curves" / "toy.csv").read_text().splitlines()
    points = [row.split(",") for row in rows[1:]]
    assert [float(v) for _, name, v in points if name == "held_out"] == scores[:4]
    assert [float(v) for _, name, v in points if name == "best"] == [3, 1, 1, 1]


def test_evaluations_are_evenly_spaced(tmp_path):
    run = open_run(tmp_path, 7)
    assert [step for step in run.steps() if run.due(3)] == [1, 3, 5]


def test_a_checkpoint_with_other_models_or_of_another_version_is_refused(tmp_path):
    adversaries(tmp_path, 2)
    with pytest.raises(BadInput, match="another architecture"):
        work(tmp_path, 4, resume=True)
    run = open_run(tmp_path, 4, resume=True)
    linear = nn.Linear(2, 2)
    run.add("maker", linear, torch.optim.Adam(linear.parameters()))
    with pytest.raises(BadInput, match="another architecture"):
        next(run.steps())
    save_file(linear.state_dict(), tmp_path / "toy.safetensors", {"step": "2", "identity": ""})
    with pytest.raises(BadInput, match="another version; train without --resume"):
        work(tmp_path, 4, resume=True)


def test_the_rate_falls_to_a_tenth_at_every_milestone(tmp_path):
    run = open_run(tmp_path, 6)
    toy = nn.Linear(2, 1)
    optimizer = torch.optim.Adam(toy.parameters(), lr=0.1)
    run.add("toy", toy, optimizer, [2, 5])
    rates = [optimizer.param_groups[0]["lr"] for _ in run.steps()]
    assert rates == pytest.approx([0.1, 0.1, 0.01, 0.01, 0.01, 0.001])
