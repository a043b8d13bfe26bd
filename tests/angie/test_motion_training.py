"""The three motion stages on synthetic clips whose motion follows the sound."""

import pytest
import torch

from angie.drift import remove_mean
from angie.gpt import GPTConfig
from angie.refiner import Refiner, RefinerConfig
from angie.schedule import BestWeights, Schedule
from angie.train_gpt import GPTTraining, code_windows, cross_entropy, train_gpt
from angie.train_refiner import (
    RefinerTraining,
    add_drift,
    held_out_loss,
    pattern_windows,
    train_refiner,
)
from angie.train_vq import VQTraining, encode_windows, normalised_deltas, train_vq
from angie.vq import VQConfig
from angie.windows import MotionWindows
from mraa.run import RunConfig

VQ = VQConfig(regions=4, width=24, codes=32, code_width=16, restart_below=0.1)
GPT = GPTConfig(codes=32, width=32, heads=2, layers=2)
REFINER = RefinerConfig(regions=4, sound=16, motion=16, hidden=16, layers=1)
CPU = RunConfig(device="cpu")


def schedule(steps: int, rate: float = 2e-3) -> Schedule:
    return Schedule(rate=rate, batch=8, most_steps=steps)


@pytest.fixture(scope="module")
def windows(clips, statistics) -> MotionWindows:
    return MotionWindows(clips[:10], statistics)


@pytest.fixture(scope="module")
def held_out(clips, statistics) -> MotionWindows:
    return MotionWindows(clips[10:], statistics)


@pytest.fixture(scope="module")
def vq(windows, tmp_path_factory):
    folder = tmp_path_factory.mktemp("vq")
    return train_vq(folder, windows, VQ, VQTraining(schedule(80, 3e-3)), run_config=CPU)


def same(one: torch.nn.Module, other: torch.nn.Module) -> bool:
    states = one.state_dict(), other.state_dict()
    return all(torch.equal(value, states[1][name]) for name, value in states[0].items())


class Killed(Exception):
    pass


def killed_and_resumed(train, folder, monkeypatch, at: int):
    """Train, kill the process before step `at` of the stage with a checkpoint there, resume."""
    from mraa import run

    steps = run.Run.steps

    def killed(self):
        for step in steps(self):
            if step == at:
                self.save()
                raise Killed
            yield step

    with monkeypatch.context() as patch:
        patch.setattr(run.Run, "steps", killed)
        with pytest.raises(Killed):
            train(folder, resume=False)
    torch.manual_seed(12345)
    return train(folder, resume=True)


def test_steps_follow_from_epochs_or_a_limit():
    paper = Schedule(rate=3e-4, milestones=(250, 400))
    assert paper.steps(640) == 10_000 and paper.milestone_steps(640) == [5000, 8000]
    short = Schedule(rate=3e-4, milestones=(250, 400), most_steps=100)
    assert short.steps(640) == 100 and short.milestone_steps(640) == [50, 80]
    assert short.steps(1) == 15 and Schedule(rate=0.1, epochs=1).steps(3) == 1


def test_the_best_weights_are_kept():
    linear = torch.nn.Linear(1, 1)
    best = BestWeights(linear)
    for score, weight in [(3.0, 1.0), (1.0, 2.0), (2.0, 3.0)]:
        linear.weight.data.fill_(weight)
        best.consider(score)
    assert best.age == 1 and best.scores()["best"] == 1
    again = BestWeights(torch.nn.Linear(1, 1))
    again.load_state_dict(best.state_dict())
    again.restore()
    assert again.model.weight.item() == 2.0


def test_vq_learns_to_reconstruct(vq, windows):
    deltas = normalised_deltas(windows.stack("poses", 0, 32), windows.statistics.delta_scale)
    error = (vq(deltas).deltas - deltas)[..., [1, 3]].abs().mean()  # the regions that move
    assert error < 0.5 * deltas[..., [1, 3]].abs().mean()
    assert vq.shift.codebook.perplexity() > 5


def test_vq_measures_the_mean_of_what_it_decodes(vq, windows):
    decoded = vq.decode(encode_windows(vq, windows))
    assert torch.allclose(remove_mean(decoded, vq.mean).mean((0, 1)), torch.zeros(20), atol=1e-5)


def test_gpt_hears(vq, windows, held_out, tmp_path):
    gpt = train_gpt(
        tmp_path, vq, windows, held_out, GPT, GPTTraining(schedule(100)), run_config=CPU
    )
    coded = code_windows(vq, held_out)
    onset = coded.stack("onset", 0, len(coded))
    deaf = coded.choose([], codes=coded.rows["codes"], onset=onset.roll(3, 0))
    assert cross_entropy(gpt, coded) < cross_entropy(gpt, deaf) - 0.1


def test_refiner_brings_patterns_nearer_to_the_truth(vq, windows, held_out, tmp_path):
    training = RefinerTraining(schedule(60, 4e-3))
    refiner = train_refiner(tmp_path, vq, windows, held_out, REFINER, training, run_config=CPU)
    patterns = pattern_windows(vq, held_out)
    assert held_out_loss(refiner, patterns) < 0.97 * held_out_loss(Refiner(REFINER), patterns)


def test_drift_is_linear_from_zero_and_in_a_share_of_the_windows():
    torch.manual_seed(0)
    drift = add_drift(torch.zeros(1000, 5, 2), torch.tensor([1.0, 10.0]), 0.5)
    assert (drift[:, 0] == 0).all()
    assert torch.allclose(drift[:, 4], 4 * drift[:, 1])
    assert drift[:, 1, 0].abs().max() <= 1 and drift[:, 1, 1].abs().max() > 5
    drifting = (drift[:, 1, 0] != 0).float().mean()
    assert 0.45 < drifting < 0.55


@pytest.mark.parametrize("update", ["ema", "loss"])
def test_a_resumed_vq_is_the_uninterrupted_one(windows, tmp_path, monkeypatch, update):
    config = VQConfig(regions=4, width=8, codes=16, code_width=8, update=update)

    def train(folder, resume):
        folder.mkdir(exist_ok=True)
        training = VQTraining(schedule(12))
        return train_vq(folder, windows, config, training, run_config=CPU, resume=resume)

    whole = train(tmp_path / "whole", False)
    assert same(whole, killed_and_resumed(train, tmp_path / "half", monkeypatch, 7))


def test_a_resumed_gpt_is_the_uninterrupted_one(vq, windows, held_out, tmp_path, monkeypatch):
    def train(folder, resume):
        folder.mkdir(exist_ok=True)
        training = GPTTraining(schedule(10), checks=5)
        return train_gpt(
            folder, vq, windows, held_out, GPT, training, run_config=CPU, resume=resume
        )

    whole = train(tmp_path / "whole", False)
    assert same(whole, killed_and_resumed(train, tmp_path / "half", monkeypatch, 5))


def test_a_finished_stage_stays_finished_however_often_it_is_resumed(windows, tmp_path):
    config = VQConfig(regions=4, width=8, codes=16, code_width=8)
    training = VQTraining(schedule(3))
    results = [
        train_vq(tmp_path, windows, config, training, run_config=CPU, resume=resume)
        for resume in (False, True, True)
    ]
    assert same(results[0], results[1]) and same(results[0], results[2])


def test_a_resumed_refiner_is_the_uninterrupted_one(vq, windows, held_out, tmp_path, monkeypatch):
    def train(folder, resume):
        folder.mkdir(exist_ok=True)
        training = RefinerTraining(schedule(8), checks=4)
        return train_refiner(
            folder, vq, windows, held_out, REFINER, training, run_config=CPU, resume=resume
        )

    whole = train(tmp_path / "whole", False)
    assert same(whole, killed_and_resumed(train, tmp_path / "half", monkeypatch, 5))
