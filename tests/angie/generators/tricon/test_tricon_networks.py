"""TriCon's networks: shapes, causality, and that every input matters."""

from dataclasses import replace

import pytest
import torch

from angie.generators.tricon.family import FAMILY, TriConSettings, lite, tiny
from angie.generators.tricon.model import (
    Critic,
    SoundEncoder,
    StyleSpace,
    TextEncoder,
    TriCon,
    TriConConfig,
    seeded,
)
from angie.generators.tricon.train import numbers_of

CONFIG = TriConConfig(points=3, width=8, layers=1, buckets=64, word_width=6, style=4, dropout=0.0)
SIZE = 15


@pytest.fixture(scope="module")
def model():
    torch.manual_seed(0)
    return TriCon(CONFIG, speakers=3).eval()


@pytest.fixture(scope="module")
def inputs(model):
    torch.manual_seed(1)
    words = torch.zeros(2, 34, dtype=torch.int64)
    words[:, 12] = 1
    return {
        "seeds": seeded(torch.randn(2, 4, SIZE), 34),
        "sound": 0.1 * torch.randn(2, CONFIG.samples),
        "words": words,
        "rows": model.words.rows(["big", "small"]),
        "style": torch.randn(2, 4),
    }


@torch.no_grad()
def poses(model, inputs):
    context = model.context(inputs["sound"], inputs["words"], inputs["rows"])
    return model.gesture(inputs["seeds"], context, inputs["style"])


def test_36267_samples_give_34_vectors():
    # 7891 after the first convolution: (36267 + 3200 - 15) // 5 + 1; then 1313, 217, 34
    assert CONFIG.samples == 36_267
    encoder = SoundEncoder()
    sound, lengths = torch.zeros(1, 1, 36_267), []
    for layer in encoder.layers:
        sound = layer(sound)
        if isinstance(layer, torch.nn.Conv1d):
            lengths.append(sound.shape[-1])
    assert lengths == [7891, 1313, 217, 34]
    assert encoder(torch.zeros(2, 36_267), 34).shape == (2, 34, 32)


def test_other_rates_are_interpolated():
    config = replace(CONFIG, fps=25, frames=57, seeds=7)
    assert config.samples == 36_480
    assert SoundEncoder()(torch.zeros(1, config.samples), 57).shape == (1, 57, 32)


def test_a_sound_vector_depends_on_a_fifth_of_a_second():
    encoder = SoundEncoder().eval()
    sound = torch.zeros(1, 36_267, requires_grad=True)
    encoder(sound, 34)[0, 20].sum().backward()
    heard = sound.grad[0].nonzero()[:, 0]
    # the layers reach 15 + 14 * 5 + 14 * 30 + 14 * 180 samples, frames lie 1080 apart
    assert heard.max() - heard.min() + 1 == 3025
    assert heard.min() == 20 * 1080 - 1600


def test_words_are_read_up_to_each_frame_and_30_before():
    torch.manual_seed(0)
    encoder = TextEncoder(6, 0.0).eval()
    for conv in (m for m in encoder.modules() if isinstance(m, torch.nn.Conv1d)):
        conv.parametrizations.weight.original0.data.fill_(1)
    vectors = torch.randn(1, 40, 6, requires_grad=True)
    encoder(vectors)[0, 35].sum().backward()
    read = vectors.grad[0].abs().sum(1).nonzero()[:, 0]
    # two convolutions of two frames in each block: 1 + 2 (1 + 2 + 4 + 8)
    assert (read.min(), read.max()) == (35 - 30, 35)


def test_seeds_are_marked():
    given = torch.full((1, 4, 2), 7.0)
    made = seeded(given, 34)
    assert made.shape == (1, 34, 3)
    assert made[0, :4].tolist() == [[7, 7, 1]] * 4 and made[0, 4:].abs().sum() == 0


@pytest.mark.parametrize("name", ["seeds", "sound", "words", "style"])
def test_every_input_matters(model, inputs, name):
    before = poses(model, inputs)
    other = dict(inputs)
    other[name] = inputs[name] * (2 if name != "words" else 0)
    assert poses(model, other).sub(before).abs().max() > 1e-5
    assert before.shape == (2, 34, SIZE)


def test_which_word_it_is_matters(model, inputs):
    other = {**inputs, "words": 2 * inputs["words"]}
    assert not torch.equal(poses(model, inputs), poses(model, other))


@pytest.mark.parametrize(
    ("change", "missing"),
    [({"context": "sound"}, "words"), ({"context": "words"}, "sound"), ({"identity": False}, None)],
)
def test_what_is_left_out_has_no_weights_and_no_say(inputs, change, missing):
    model = TriCon(replace(CONFIG, **change), 3).eval()
    assert not hasattr(model, missing or "styles")
    if missing:
        other = {**inputs, missing: 0 * inputs[missing]}
        assert torch.equal(poses(model, inputs), poses(model, other))
    else:
        inputs = {**inputs, "style": torch.zeros(2, 0)}
        assert poses(model, inputs).shape == (2, 34, SIZE)


def test_training_gives_both_styles_and_learns_from_the_first_alone(model, inputs):
    speaker, other = torch.tensor([0, 1]), torch.tensor([2, 1])
    made = model(*list(inputs.values())[:4], speaker, other)
    assert made.pose.requires_grad and not made.other_pose.requires_grad
    assert made.style.shape == made.other_style.shape == (2, 4)
    assert not torch.equal(made.mean[0], made.mean[1])


def test_the_style_space_draws_around_the_mean():
    torch.manual_seed(0)
    space = StyleSpace(2, 3)
    mean, log_variance = space(torch.tensor([1]))
    drawn = TriCon.draw(None, mean.expand(20_000, -1), log_variance.expand(20_000, -1))
    assert torch.allclose(drawn.mean(0), mean[0], atol=0.05)
    assert torch.allclose(drawn.std(0), (0.5 * log_variance[0]).exp(), rtol=0.05)


def test_the_critic_gives_a_probability_for_each_window():
    critic = Critic(SIZE, 34)
    assert critic.all.in_features == 28  # three valid convolutions of 3: 34 - 6
    told = critic(torch.randn(5, 34, SIZE))
    assert told.shape == (5,) and (told > 0).all() and (told < 1).all()


def test_presets():
    assert numbers_of(TriCon(lite().model, 4)) < 4_000_000
    paper = TriConSettings().model
    assert (paper.frames, paper.seeds, paper.fps, paper.style) == (34, 4, 15, 8)
    assert (paper.width, paper.layers, paper.word_width) == (300, 4, 300)
    assert TriConSettings().train.word_dropout == 0
    assert FAMILY.fit(tiny(), 10, False) == tiny()
    # 10 joints in space: nine unit vectors of three numbers
    skeleton = TriCon(replace(paper, points=10, extent=False, axes=3, buckets=64), 2)
    assert skeleton.poses.size == 27 and skeleton.out[-1].out_features == 27


@pytest.mark.parametrize(
    "change", [{"context": "smell"}, {"encoder": "bert"}, {"pose": "directions"}, {"axes": 3},
               {"seeds": 30}, {"layers": 0}],
)  # fmt: skip
def test_sizes_that_cannot_be(change):
    with pytest.raises(ValueError):
        replace(CONFIG, **change)


def test_a_step_of_the_paper_s_sizes():
    torch.manual_seed(0)
    config = TriConSettings().model
    model = TriCon(config, 2)
    assert 22e6 < numbers_of(model) < 23e6  # 15 of them for the parts of words
    words = torch.zeros(2, 34, dtype=torch.int64)
    words[:, 5] = 1
    speaker = torch.tensor([0, 1])
    made = model(
        seeded(torch.zeros(2, 4, 100), 34), torch.randn(2, 36_267), words,
        model.words.rows(["idea"]), speaker, speaker.flip(0),
    )  # fmt: skip
    assert made.pose.shape == (2, 34, 100)
    made.pose.square().mean().backward()
    assert all(p.grad is not None and p.grad.isfinite().all() for p in model.parameters())
