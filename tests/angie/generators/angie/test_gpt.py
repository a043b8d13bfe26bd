import copy
import dataclasses

import pytest
import torch

from angie.generators.angie.gpt import CoSpeechGPT, GPTConfig
from angie.generators.angie.sampling import Sampling, Window, continue_codes, draw, stuck

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
    generated = continue_codes(gpt, start, onset, GREEDY, torch.Generator())
    assert generated.shape == (2, 6) and torch.equal(generated[:, :1], start)
    logits = gpt(generated[None, :, :-1], onset[None, 1:])[0]
    assert torch.equal(logits.argmax(-1), generated[:, 1:])


def test_beyond_the_block_the_last_codes_and_their_sound_are_seen(gpt):
    onset = torch.randn(20, 10)
    generated = continue_codes(gpt, torch.tensor([[3], [7]]), onset, GREEDY, torch.Generator())
    for step in range(6, 20):
        seen, sound = generated[None, :, step - 5 : step], onset[None, step - 4 : step + 1]
        assert torch.equal(gpt(seen, sound)[0, :, -1].argmax(-1), generated[:, step])


def test_step_by_step_with_the_cache_equals_the_whole_window(gpt, codes, onset):
    whole = gpt(codes, onset)
    cache = gpt.cache(2)
    for step in range(5):
        now = slice(step, step + 1)
        assert not cache.full
        logits = gpt.advance(codes[..., now], onset[:, now], cache)
        assert torch.allclose(logits, whole[:, :, step], atol=1e-5)
    assert cache.full
    with pytest.raises(ValueError, match="up to 5"):
        gpt.advance(codes[..., :1], onset[:, :1], cache)


def test_a_window_that_begins_with_several_steps_goes_on_one_by_one(gpt, codes, onset):
    whole = gpt(codes, onset)
    cache = gpt.cache(2)
    logits = gpt.advance(codes[..., :3], onset[:, :3], cache)
    assert torch.allclose(logits, whole[:, :, 2], atol=1e-5)
    for step in (3, 4):
        now = slice(step, step + 1)
        logits = gpt.advance(codes[..., now], onset[:, now], cache)
        assert torch.allclose(logits, whole[:, :, step], atol=1e-5)
    with pytest.raises(ValueError, match="empty cache"):
        gpt.advance(codes[..., :2], onset[:, :2], cache)


def test_hopping_begins_new_windows_with_the_last_codes(gpt):
    onset, start = torch.randn(20, 10), torch.tensor([[3], [7]])
    hop = Window("hop", context=2)
    made = continue_codes(gpt, start, onset, GREEDY, torch.Generator(), window=hop)
    first = 0
    for step in range(1, 20):
        if step - first > 5:
            first = step - 2
        seen, sound = made[None, :, first:step], onset[None, first + 1 : step + 1]
        assert torch.equal(gpt(seen, sound)[0, :, -1].argmax(-1), made[:, step])
    slid = continue_codes(gpt, start, onset, GREEDY, torch.Generator())
    assert torch.equal(slid[:, :6], made[:, :6])  # the first window is the same


def test_hopping_computes_most_steps_alone(gpt, monkeypatch):
    computed = []
    embed = CoSpeechGPT._embed

    def counted(self, codes, *rest):
        computed.append(codes.shape[-1])
        return embed(self, codes, *rest)

    monkeypatch.setattr(CoSpeechGPT, "_embed", counted)
    for window, expected in [("hop", [1] * 5 + [3, 1, 1] * 5), ("slide", [1] * 5 + [5] * 15)]:
        computed.clear()
        start, onset = torch.tensor([[3], [7]]), torch.randn(21, 10)
        window = Window(window, context=3)
        continue_codes(gpt, start, onset, GREEDY, torch.Generator(), window=window)
        assert computed == expected


def test_bad_windows_are_refused():
    with pytest.raises(ValueError, match="slide, hop"):
        Window("jump")
    with pytest.raises(ValueError, match="at least one"):
        Window("hop", context=0)


def test_one_stream_alone():
    gpt = CoSpeechGPT(dataclasses.replace(TINY, streams=1)).eval()
    codes, onset = torch.randint(16, (2, 1, 5)), torch.randn(2, 5, 10)
    logits = gpt(codes, onset)
    assert logits.shape == (2, 1, 5, 16) and gpt.positions.shape == (1, 10, 24)
    assert CoSpeechGPT.loss(logits, codes).item() == pytest.approx(
        torch.nn.functional.cross_entropy(logits.flatten(0, 2), codes.flatten()).item(), abs=1e-5
    )
    start = torch.tensor([[3]])
    made = continue_codes(gpt, start, torch.randn(9, 10), GREEDY, torch.Generator())
    assert made.shape == (1, 9)
    assert not [name for name, _ in gpt.named_parameters() if "cholesky" in name]


def test_a_joint_model_hears_who_speaks(codes, onset):
    torch.manual_seed(0)
    gpt = CoSpeechGPT(dataclasses.replace(TINY, joint=True), speakers=2).eval()
    torch.nn.init.normal_(gpt.speaker.weight)
    first, second, anyone = (gpt(codes, onset, torch.tensor([who, who])) for who in (0, 1, 2))
    assert not torch.allclose(first, second, atol=1e-4)
    assert not torch.allclose(first, anyone, atol=1e-4)
    assert torch.equal(gpt(codes, onset), anyone)
    onset, drawn = torch.randn(20, 10), []
    for who in (0, 1, None):
        start, generator = torch.tensor([[3], [7]]), torch.Generator().manual_seed(0)
        drawn.append(continue_codes(gpt, start, onset, Sampling(), generator, speaker=who))
    assert not torch.equal(drawn[0], drawn[1]) and not torch.equal(drawn[0], drawn[2])


def test_a_longer_start_is_continued(gpt):
    onset = torch.randn(9, 10)
    whole = continue_codes(gpt, torch.tensor([[3], [7]]), onset, GREEDY, torch.Generator())
    again = continue_codes(gpt, whole[:, :4], onset, GREEDY, torch.Generator())
    assert torch.equal(whole, again)
    assert torch.equal(
        continue_codes(gpt, whole, onset[:4], GREEDY, torch.Generator()), whole[:, :4]
    )


def test_the_same_seed_draws_the_same_codes_and_another_other_ones(gpt):
    def drawn(seed):
        generator = torch.Generator().manual_seed(seed)
        return continue_codes(
            gpt, torch.tensor([[3], [7]]), torch.ones(30, 10), Sampling(), generator
        )

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


def test_calm_sampling_leaves_nothing_to_chance_in_silence():
    logits = torch.zeros(2, 16)
    logits[:, 5] = 0.1
    calm, codes = Sampling(calm=True), torch.zeros(2, 3, dtype=torch.int64)
    drawn = {
        voiced: {
            tuple(draw(logits, codes, calm, torch.Generator().manual_seed(i), voiced).tolist())
            for i in range(20)
        }
        for voiced in (True, False)
    }
    assert drawn[False] == {(5, 5)} and len(drawn[True]) > 5


def test_long_silence_is_still_where_sampling_is_calm(gpt):
    onset = torch.zeros(12, 10)
    voiced = torch.tensor([True] * 3 + [False] * 8 + [True])
    still = torch.tensor([15, 14])

    def codes(calm: bool) -> torch.Tensor:
        begin, source = torch.zeros(2, 1, dtype=torch.int64), torch.Generator().manual_seed(0)
        sampling = Sampling(method="topk", k=4, calm=calm)
        return continue_codes(gpt, begin, onset, sampling, source, voiced=voiced, still=still)

    calm = codes(True)
    assert (calm[:, 6:11] == still[:, None]).all() and not (calm[:, 5] == still).all()
    assert not (codes(False)[:, 6:11] == still[:, None]).all()


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


def test_each_head_reads_the_block_of_its_own_stream(codes, onset):
    torch.manual_seed(0)
    model = CoSpeechGPT(TINY).eval()
    for parameter in model.layers.parameters():
        torch.nn.init.zeros_(parameter)  # every token stays what was put in
    logits = model(codes, onset)
    for stream in (0, 1):
        other = codes.clone()
        other[:, stream] = (other[:, stream] + 1) % 16
        changed = model(other, onset)
        assert not torch.allclose(changed[:, stream], logits[:, stream])
        assert torch.equal(changed[:, 1 - stream], logits[:, 1 - stream])
    assert torch.equal(model(codes, onset + 1), logits)  # the sound's block has no head


def test_every_step_of_every_block_has_its_place(gpt, codes, onset):
    logits = gpt(codes, onset)
    for row in (3, 5 + 3, 10 + 3):  # step 3 of the sound's block and of both streams'
        other = copy.deepcopy(gpt)
        with torch.no_grad():
            other.positions[0, row] += torch.linspace(-1, 1, 24)
        changed = other(codes, onset)
        assert torch.equal(changed[:, :, :3], logits[:, :, :3])
        assert not torch.allclose(changed[:, :, 3], logits[:, :, 3], atol=1e-4)
