"""Losses of TriCon with numbers worked out by hand, its windows, and its training."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from angie.generators.tricon.family import FAMILY, tiny
from angie.generators.tricon.model import Made
from angie.generators.tricon.train import (
    TriConTraining,
    Windows,
    begin_model,
    critic_loss,
    divergence,
    generator_losses,
    hidden,
    piece,
    style_loss,
    train_generator,
    window_poses,
    word_rows,
)
from data_prep.errors import BadInput
from mraa.training.run import Run

PAPER = TriConTraining()


def made(pose, other, style=0.5, other_style=0.0) -> Made:
    pose = torch.tensor([[[pose]]], requires_grad=True)
    one, two = torch.tensor([[style]]), torch.tensor([[other_style]])
    return Made(pose, one, torch.zeros(1, 1), torch.zeros(1, 1), torch.tensor([[[other]]]), two)


def test_other_styles_are_to_move_otherwise():
    # smooth L1 of 1 with beta 0.05 is 1 - 0.025; styles are 0.5 apart
    assert style_loss(made(1.0, 0.0)).item() == pytest.approx(-0.975 / 0.50001)
    # below beta it is the square by twice beta: 0.02 ** 2 / 0.1
    assert style_loss(made(0.02, 0.0)).item() == pytest.approx(-0.004 / 0.50001, rel=1e-5)
    assert style_loss(made(1.0, 0.0, 0.3, 0.3)).item() == -1000  # 0.975 / 1e-5 is more
    several = made(1.0, 0.0)  # two frames of three channels
    several = several._replace(pose=torch.ones(1, 2, 3), other_pose=torch.zeros(1, 2, 3))
    assert style_loss(several).item() == pytest.approx(6 * -0.975 / 0.50001)
    result = made(0.5, 0.2)
    style_loss(result).backward()
    assert result.pose.grad.item() < 0  # going down, the pose leaves the other one


def test_the_divergence_from_a_standard_gaussian():
    zero, one = torch.zeros(2, 3), torch.ones(2, 3)
    assert divergence(zero, zero) == 0
    assert divergence(3 * one, zero).item() == pytest.approx(4.5)
    # log variance 1: -0.5 (1 + 1 - e)
    assert divergence(zero, one).item() == pytest.approx(0.5 * (math.e - 2))


def test_weights_are_the_paper_s():
    losses = generator_losses(made(0.05, 0.0), torch.zeros(1, 1, 1), PAPER, torch.tensor([0.5]))
    # Huber with beta 0.1: 0.05 ** 2 / 0.2, times 500
    assert losses["huber"].item() == pytest.approx(6.25)
    assert losses["adversarial"].item() == pytest.approx(5 * math.log(2), rel=1e-5)
    assert losses["style"].item() == pytest.approx(0.05 * style_loss(made(0.05, 0.0)).item())
    assert losses["divergence"] == 0
    assert "adversarial" not in generator_losses(made(0.0, 0.0), torch.zeros(1, 1, 1), PAPER, None)
    bare = replace(PAPER, style=0.0, divergence=0.0)
    assert list(generator_losses(made(0.0, 0.0), torch.zeros(1, 1, 1), bare, None)) == ["huber"]


def test_a_larger_error_costs_more_than_a_small_one_in_proportion():
    one = generator_losses(made(1.0, 0.0), torch.zeros(1, 1, 1), PAPER, None)["huber"]
    assert one.item() == pytest.approx(500 * 0.95)


def test_the_critic_is_to_tell_them_apart():
    half = torch.full((3,), 0.5)
    assert critic_loss(half, half).item() == pytest.approx(2 * math.log(2), rel=1e-5)
    right, wrong = torch.full((3,), 0.9), torch.full((3,), 0.1)
    assert critic_loss(right, wrong) < critic_loss(half, half) < critic_loss(wrong, right)


def test_sound_of_a_window(settings):
    config = settings.model
    samples = np.arange(40_000, dtype=np.float32)
    cut = piece(samples, 30, config)
    # two seconds in: 30 frames of 16000 / 15 samples
    assert cut.shape == (36_267,) and cut[0] == 32_000
    assert cut[7_999] == 39_999 and cut[8_000:].sum() == 0
    assert piece(np.full(5, 32767, np.int16), 0, config)[:6].tolist() == [1, 1, 1, 1, 1, 0]
    assert piece(samples, 90, config).sum() == 0
    assert len(piece(samples, 0, replace(config, context="words"))) == 0


def test_words_are_hidden_window_by_window():
    torch.manual_seed(0)
    words = torch.ones(1000, 3, dtype=torch.int64)
    left = hidden(words, 0.2).float().mean(1)
    assert set(left.tolist()) == {0.0, 1.0} and 0.75 < left.mean() < 0.85
    assert hidden(words, 0.0) is words


@pytest.fixture
def windows(make_context, talks, settings, tmp_path):
    context = make_context(tmp_path)
    said = [word.word for clip in talks for word in clip.speech.words]
    model = begin_model(context, talks, said)
    return Windows(talks, model, context, word_rows(model, said)[1])


def test_windows(windows, talks):
    windows.cut(10)
    # 6 s are 90 frames at 15 a second, the last of which is at 5.93 s; 34 fit at 0, 10, ... 50
    assert len(windows) == 12 * 6
    item = windows[7]  # the second of the second clip
    assert item["pose"].shape == (34, 15) and item["sound"].shape == (36_267,)
    assert item["speaker"] == 0  # ada
    sound = talks[1].speech.samples[10_667 : 10_667 + 36_267]
    assert np.allclose(item["sound"].numpy(), sound, atol=1e-4)
    starts = [int(word.start * 15) - 10 for word in talks[1].speech.words]
    assert item["words"].nonzero()[:, 0].tolist() == [f for f in starts if 0 <= f < 34]


def test_windows_that_are_left_out(windows):
    windows.cut(10)
    several = sum(int((windows[i]["words"] > 0).sum() >= 2) for i in range(len(windows)))
    active = torch.zeros(15, dtype=torch.bool)
    active[1] = True
    windows.choose(replace(PAPER, drop_plain=0.0, drop_still=0.5), [True] * 12, active)
    assert 0 < len(windows) <= several // 2 + 1
    assert all((windows[i]["words"] > 0).sum() >= 2 for i in range(len(windows)))
    still = window_poses(windows)[..., 1].var(1)
    windows.choose(replace(PAPER, least_words=0, drop_plain=0, drop_still=0.9), [True] * 12, active)
    assert window_poses(windows)[..., 1].var(1).min() >= still.quantile(0.8)


def test_training_takes_the_best_weights(trained):
    assert trained.report["windows"] > 60 and trained.report["fgd"] > 0
    assert trained.report["fgd_still"] > 0
    assert trained.tensors["poses.parents"].dtype == torch.int64
    assert FAMILY.report("generator", trained.report, None)[1].startswith("held-out FGD")


def test_the_critic_learns_after_the_quiet_steps_only(
    make_context, settings, tmp_path, monkeypatch
):
    seen = []

    def update(run, loss, *names, **options):
        seen.append((run.step, *names))

    monkeypatch.setattr(Run, "update", update)
    training = replace(
        settings.train, quiet=0.5, schedule=replace(settings.train.schedule, most_steps=4)
    )
    train_generator(make_context(tmp_path, replace(settings, train=training)))
    own = [entry for entry in seen if entry[1] != "fgd"]
    assert own[-6:] == [
        (0, "generator"), (1, "generator"),
        (2, "critic"), (2, "generator"), (3, "critic"), (3, "generator"),
    ]  # fmt: skip


def test_a_killed_training_goes_on_bit_for_bit(
    make_context, settings, trained, tmp_path, monkeypatch
):
    log = Run.log

    def killed(run, **scalars):
        log(run, **scalars)
        if run.stage == "generator" and run.step == 4:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Run, "log", killed)
        with pytest.raises(KeyboardInterrupt):
            train_generator(make_context(tmp_path, checkpoint_seconds=0))
    again = train_generator(make_context(tmp_path, resume=True))
    assert again.report == trained.report
    for name, value in trained.tensors.items():
        assert torch.equal(again.tensors[name], value), name


def test_nothing_left_to_learn_from(make_context, settings, tmp_path):
    training = replace(settings.train, least_words=9)
    with pytest.raises(BadInput, match="tricon.train.least_words=0"):
        train_generator(make_context(tmp_path, replace(settings, train=training)))
    model = replace(settings.model, encoder="vectors")
    with pytest.raises(BadInput, match="name a .vec file"):
        train_generator(make_context(tmp_path, replace(settings, model=model)))


@pytest.mark.parametrize("name", FAMILY.variants)
def test_variants_leave_one_thing_out(name):
    changed, whole = FAMILY.variants[name].change(tiny()), tiny()
    assert (changed == whole) == (name == "full")


@pytest.mark.parametrize("change", [{"huber": -1.0}, {"quiet": 1.0}, {"stride": 0}])
def test_trainings_that_cannot_be(change):
    with pytest.raises(ValueError):
        replace(PAPER, **change)
