import pytest
import torch

from angie.gpt import CoSpeechGPT, GPTConfig
from angie.sampling import Sampling, draw, stuck

TINY = GPTConfig(codes=16, onset=10, width=24, heads=3, layers=3, block=5, dropout=0.1)
GREEDY = Sampling(method="greedy")


@pytest.fixture(scope="module")
def gpt() -> CoSpeechGPT:
    torch.manual_seed(0)
    model = CoSpeechGPT(TINY).eval()
    for parameter in model.parameters():  # large weights, so that every dependence shows
        torch.nn.init.normal_(parameter, std=0.3)
    return model


@pytest.fixture
def codes() -> torch.Tensor:
    return torch.randint(16, (2, 2, 5), generator=torch.Generator().manual_seed(1))


@pytest.fixture
def onset() -> torch.Tensor:
    return torch.randn(2, 5, 10, generator=torch.Generator().manual_seed(2))


@pytest.mark.parametrize("step", range(5))
@pytest.mark.parametrize("what", ["shift", "cholesky", "sound"])
def test_a_step_sees_itself_and_the_past_only(gpt, codes, onset, what, step):
    logits = gpt(codes, onset)
    codes, onset = codes.clone(), onset.clone()
    if what == "sound":
        onset[:, step] += 1
    else:
        codes[:, int(what == "cholesky"), step] += 1
        codes %= 16
    changed = gpt(codes, onset)
    assert torch.equal(changed[:, :, :step], logits[:, :, :step])
    for later in range(step, 5):  # both streams react at the step and at every later one
        difference = (changed[:, :, later] - logits[:, :, later]).abs().amax((0, 2))
        assert (difference > 1e-6).all()


def test_a_shorter_sequence_gives_the_same_logits(gpt, codes, onset):
    logits = gpt(codes, onset)
    assert logits.shape == (2, 2, 5, 16)
    assert torch.allclose(gpt(codes[..., :3], onset[:, :3]), logits[:, :, :3], atol=1e-6)


def test_the_loss_is_the_sum_of_both_streams(codes):
    logits = torch.zeros(2, 2, 5, 16)
    assert CoSpeechGPT.loss(logits, codes).item() == pytest.approx(2 * torch.tensor(16.0).log())


def test_more_steps_than_the_block_are_refused(gpt):
    with pytest.raises(ValueError, match="up to 5"):
        gpt(torch.zeros(1, 2, 6, dtype=torch.int64), torch.zeros(1, 6, 10))
    with pytest.raises(ValueError, match="onset"):
        gpt(torch.zeros(1, 2, 4, dtype=torch.int64), torch.zeros(1, 5, 10))


def test_the_sliding_window_equals_the_full_forward_inside_the_block(gpt):
    start, onset = torch.tensor([[3], [7]]), torch.randn(6, 10)
    generated = gpt.generate(start, onset, GREEDY, torch.Generator())
    assert generated.shape == (2, 6) and torch.equal(generated[:, :1], start)
    logits = gpt(generated[None, :, :-1], onset[None, 1:])[0]
    assert torch.equal(logits.argmax(-1), generated[:, 1:])


def test_beyond_the_block_the_last_codes_and_their_sound_are_seen(gpt):
    onset = torch.randn(20, 10)
    generated = gpt.generate(torch.tensor([[3], [7]]), onset, GREEDY, torch.Generator())
    for step in range(6, 20):
        seen, sound = generated[None, :, step - 5 : step], onset[None, step - 4 : step + 1]
        assert torch.equal(gpt(seen, sound)[0, :, -1].argmax(-1), generated[:, step])


def test_a_longer_start_is_continued(gpt):
    onset = torch.randn(9, 10)
    whole = gpt.generate(torch.tensor([[3], [7]]), onset, GREEDY, torch.Generator())
    again = gpt.generate(whole[:, :4], onset, GREEDY, torch.Generator())
    assert torch.equal(whole, again)
    assert torch.equal(gpt.generate(whole, onset[:4], GREEDY, torch.Generator()), whole[:, :4])


def test_the_same_seed_draws_the_same_codes_and_another_other_ones(gpt):
    def drawn(seed):
        generator = torch.Generator().manual_seed(seed)
        return gpt.generate(torch.tensor([[3], [7]]), torch.ones(30, 10), Sampling(), generator)

    assert torch.equal(drawn(1), drawn(1))
    assert not torch.equal(drawn(1), drawn(2))


def test_top_k_draws_among_the_k_most_likely():
    logits = torch.stack([torch.arange(16.0) * 0.01, -torch.arange(16.0) * 0.01])
    generator = torch.Generator().manual_seed(0)
    sampling = Sampling(k=3)
    none = torch.zeros(2, 0, dtype=torch.int64)
    pairs = torch.stack([draw(logits, none, sampling, generator, True) for _ in range(200)])
    assert set(pairs[:, 0].tolist()) == {13, 14, 15}
    assert set(pairs[:, 1].tolist()) == {0, 1, 2}


def test_ties_go_to_the_smaller_code():
    none = torch.zeros(2, 0, dtype=torch.int64)
    only = Sampling(k=1)
    pair = draw(torch.zeros(2, 16), none, only, torch.Generator(), True)
    assert pair.tolist() == [0, 0]


def test_the_repeat_guard_acts_after_four_repeats_and_in_sound_only():
    logits = torch.zeros(2, 16)
    logits[:, 5] = 9
    logits[:, 2] = 3
    guarded = Sampling(method="greedy", repeat_guard=True)
    for length, voiced, expected in [(4, True, 5), (5, True, 2), (5, False, 5)]:
        codes = torch.full((2, length), 5)
        assert draw(logits, codes, guarded, torch.Generator(), voiced).tolist() == [expected] * 2
    assert draw(logits, torch.full((2, 9), 5), GREEDY, torch.Generator(), True).tolist() == [5, 5]
    assert not stuck(torch.tensor([[1, 1, 1, 1, 1], [0, 1, 0, 0, 0]]))


def test_bad_sampling_is_refused():
    for options in ({"method": "beam"}, {"k": 0}, {"temperature": 0.0}):
        with pytest.raises(ValueError, match="sampling|top-k"):
            Sampling(**options)


def test_the_paper_preset_has_the_paper_s_shapes():
    with torch.device("meta"):
        gpt = CoSpeechGPT(GPTConfig())
    assert len(gpt.layers) == 12 and gpt.layers[0].attention.heads == 12
    assert gpt.positions.shape == (1, 33, 768)
    assert gpt.sound.weight.shape == (768, 426)
    assert gpt.shift.weight.shape == gpt.cholesky_head.weight.shape == (512, 768)
    layer = 4 * 768 * 768 + 4 * 768 + 2 * 4 * 768 * 768 + 5 * 768 + 4 * 768
    outside = 426 * 768 + 768 + 4 * 512 * 768 + 33 * 768 + 2 * 768
    assert sum(p.numel() for p in gpt.parameters()) == 12 * layer + outside
