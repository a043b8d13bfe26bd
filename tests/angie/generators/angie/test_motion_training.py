"""The three motion stages on synthetic clips whose motion follows the sound."""

import dataclasses

import pytest
import torch

from angie.generators.angie.channels import Channels
from angie.generators.angie.codes import encode_windows, reconstruction
from angie.generators.angie.gpt import GPTConfig
from angie.generators.angie.refiner import Refiner, RefinerConfig
from angie.generators.angie.tokenizer import DirectMotion, VQConfig, VQMotionExtractor
from angie.generators.angie.train import (
    NORMS,
    GPTTraining,
    VQTraining,
    code_windows,
    cross_entropy,
    direct_error,
    speaker_dropout,
    stream_entropies,
    train_direct,
    train_gpt,
    train_vq,
)
from angie.generators.angie.train_refiner import (
    RefinerTraining,
    add_drift,
    held_out_loss,
    pattern_windows,
    train_refiner,
)
from angie.motion.drift import remove_mean
from angie.motion.windows import MotionWindows
from mraa.training.checkpoint import Schedule
from mraa.training.run import Run, RunConfig

VQ = VQConfig(regions=4, width=24, codes=32, code_width=16, update="ema")
GPT = GPTConfig(codes=32, width=32, heads=2, layers=2)
REFINER = RefinerConfig(regions=4, sound=16, motion=16, hidden=16, layers=1)
CPU = RunConfig(device="cpu")


def begun(folder, stage="stage", resume=False):
    """What begins the run of a stage in a folder, as `StageContext.begin` does."""
    return lambda steps: Run(folder, stage, steps=steps, config=CPU, resume=resume)


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
    return train_vq(begun(folder), windows, None, VQ, VQTraining(schedule(80, 3e-3)))


def same(one: torch.nn.Module, other: torch.nn.Module) -> bool:
    states = one.state_dict(), other.state_dict()
    return all(torch.equal(value, states[1][name]) for name, value in states[0].items())


class Killed(Exception):
    pass


def killed_and_resumed(train, folder, monkeypatch, at: int):
    """Train, kill the process before step `at` of the stage with a checkpoint there, resume."""
    from mraa.training import run

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


def test_after_a_warmup_the_codebooks_begin_with_clusters(vq, windows, tmp_path, monkeypatch):
    asked = []
    init = VQMotionExtractor.init_codebook
    monkeypatch.setattr(
        VQMotionExtractor,
        "init_codebook",
        lambda self, deltas: (asked.append(len(deltas)), init(self, deltas)),
    )
    training = VQTraining(schedule(40, 3e-3), warmup=0.5, path_loss=1.0)
    warm = train_vq(begun(tmp_path), windows, None, VQ, training)
    assert asked == [len(windows)] and reconstruction(warm, windows)["shift_used"] > 5
    deltas = Channels.of(windows.statistics).normalise(windows.stack("poses", 0, 32))
    squared = dataclasses.replace(training, path_loss_norm="square")
    wide = train_vq(begun(tmp_path / "wide"), windows, None, VQ, squared)
    paths = [(one(deltas).deltas - deltas).cumsum(1) for one in (vq, warm, wide)]
    plain, absolute, square = (path.abs().mean() for path in paths)
    assert absolute < plain and square < plain  # what `path_loss` weighs
    assert not torch.equal(paths[1], paths[2])
    weighed = {name: norm(torch.tensor([3.0, -1.0])).tolist() for name, norm in NORMS.items()}
    assert weighed == {"absolute": [3, 1], "square": [9, 1]}
    with pytest.raises(ValueError, match="path_loss_norm is one of absolute, square"):
        VQTraining(path_loss_norm="cube")


def test_vq_learns_to_reconstruct(vq, windows):
    deltas = Channels.of(windows.statistics).normalise(windows.stack("poses", 0, 32))
    error = (vq(deltas).deltas - deltas)[..., [1, 3]].abs().mean()  # the regions that move
    assert error < 0.5 * deltas[..., [1, 3]].abs().mean()
    assert vq.shift.codebook.perplexity() > 5


def test_vq_measures_the_mean_of_what_it_decodes(vq, windows):
    decoded = vq.decode(encode_windows(vq, windows))
    assert torch.allclose(remove_mean(decoded, vq.mean).mean((0, 1)), torch.zeros(20), atol=1e-5)


def test_gpt_hears(vq, clips, statistics, held_out, tmp_path):
    windows = MotionWindows(clips[:10], statistics, stride=8)  # as lite; every 32 is too few
    gpt = train_gpt(begun(tmp_path), vq, windows, held_out, GPT, GPTTraining(schedule(100)))
    coded = code_windows(vq, held_out)
    onset = coded.stack("onset", 0, len(coded))
    deaf = coded.choose(["speaker"], codes=coded.rows["codes"], onset=onset.roll(3, 0))
    assert cross_entropy(gpt, coded) < cross_entropy(gpt, deaf) - 0.1


def test_refiner_brings_patterns_nearer_to_the_truth(vq, windows, held_out, tmp_path):
    training = RefinerTraining(schedule(60, 4e-3))
    refiner = train_refiner(begun(tmp_path), vq, windows, held_out, REFINER, training)
    patterns = pattern_windows(vq, held_out)
    before, after = (held_out_loss(one, patterns, training) for one in (Refiner(REFINER), refiner))
    assert after < 0.97 * before
    fast = dataclasses.replace(training, velocity=1.0)  # weights are chosen by all that is trained
    assert held_out_loss(refiner, patterns, fast) > after


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
        return train_vq(begun(folder, "vq", resume), windows, None, config, training)

    whole = train(tmp_path / "whole", False)
    assert same(whole, killed_and_resumed(train, tmp_path / "half", monkeypatch, 7))


def test_a_resumed_gpt_is_the_uninterrupted_one(vq, windows, held_out, tmp_path, monkeypatch):
    def train(folder, resume):
        folder.mkdir(exist_ok=True)
        training = GPTTraining(schedule(10), checks=5)
        return train_gpt(begun(folder, "gpt", resume), vq, windows, held_out, GPT, training)

    whole = train(tmp_path / "whole", False)
    assert same(whole, killed_and_resumed(train, tmp_path / "half", monkeypatch, 5))


def test_a_finished_stage_stays_finished_however_often_it_is_resumed(windows, tmp_path):
    config = VQConfig(regions=4, width=8, codes=16, code_width=8)
    training = VQTraining(schedule(3))
    results = [
        train_vq(begun(tmp_path, "vq", resume), windows, None, config, training)
        for resume in (False, True, True)
    ]
    assert same(results[0], results[1]) and same(results[0], results[2])


def test_a_resumed_refiner_is_the_uninterrupted_one(vq, windows, held_out, tmp_path, monkeypatch):
    def train(folder, resume):
        folder.mkdir(exist_ok=True)
        training = RefinerTraining(schedule(8), checks=4)
        begin = begun(folder, "refiner", resume)
        return train_refiner(begin, vq, windows, held_out, REFINER, training)

    whole = train(tmp_path / "whole", False)
    assert same(whole, killed_and_resumed(train, tmp_path / "half", monkeypatch, 5))


def test_regression_from_the_sound_learns(windows, held_out, tmp_path):
    sizes = dataclasses.replace(VQ, quant="no_quant")
    few = windows.chosen([0, 1, 2])
    training = GPTTraining(schedule(60, 3e-3), checks=4)
    direct = train_direct(begun(tmp_path), few, few, sizes, GPT, training)
    torch.manual_seed(0)
    fresh = DirectMotion(sizes, GPT, 2)
    assert direct_error(direct, few) < 0.9 * direct_error(fresh, few)
    patterned = pattern_windows(direct, held_out)
    pattern, poses = patterned.rows["pattern"][0], patterned[0]["poses"]
    scale = windows.statistics.pose_scale
    assert pattern.shape == (96, 20) and torch.allclose(pattern[0] * scale, poses[1], atol=1e-5)


def test_a_joint_model_learns_who_speaks(vq, windows, held_out, tmp_path):
    joint = dataclasses.replace(GPT, joint=True)
    gpt = train_gpt(begun(tmp_path), vq, windows, held_out, joint, GPTTraining(schedule(6)))
    assert gpt.speaker.num_embeddings == 3
    coded = code_windows(vq, held_out)
    entropies = stream_entropies(gpt, coded)
    assert cross_entropy(gpt, coded) == pytest.approx(float(entropies.sum()))
    torch.manual_seed(0)
    hidden = speaker_dropout(torch.zeros(4000, dtype=torch.int64), 2)
    assert set(hidden.tolist()) == {0, 2} and 0.07 < (hidden == 2).float().mean() < 0.13


def test_velocity_in_the_loss_brings_changes_nearer_to_the_truth(vq, windows, tmp_path):
    seen = pattern_windows(vq, windows)
    pattern, mfcc = seen.stack("pattern", 0, 32), seen.stack("mfcc", 0, 32)
    truth = seen.stack("poses", 0, 32)[:, 1:] / windows.statistics.pose_scale

    def error(weight: float) -> float:
        training = RefinerTraining(schedule(25, 4e-3), velocity=weight)
        folder = tmp_path / str(weight)
        refiner = train_refiner(begun(folder), vq, windows, None, REFINER, training)
        off = pattern + refiner(mfcc, pattern) - truth
        return float(off.detach().diff(dim=1).abs().mean())

    assert error(20.0) < error(0.0)
