"""Motion to sound as it comes: nothing depends on what is later than the look-ahead."""

import dataclasses

import numpy as np
import pytest
import torch

from angie.generators.angie.generate import AngieGenerator, GenerationConfig
from angie.generators.angie.gpt import CoSpeechGPT, GPTConfig
from angie.generators.angie.refiner import Refiner, RefinerConfig
from angie.generators.angie.sampling import Sampling
from angie.generators.angie.tokenizer import VQConfig, VQMotionExtractor
from data_prep.speech.features import Speech

AHEAD = GenerationConfig(
    blend="ahead", bounding="on", sampling=Sampling("greedy", calm=True, voice="causal")
)
TOKENS, CHANGED = 40, 25
"""Tokens of the sound, and the first one that is another."""


@pytest.fixture(scope="module")
def generator(statistics) -> AngieGenerator:
    torch.manual_seed(0)
    vq = VQMotionExtractor(VQConfig(regions=4, width=16, codes=32, code_width=8)).train()
    vq(torch.randn(8, 96, 20))
    sizes = GPTConfig(codes=32, onset=114, width=24, heads=3, layers=2, sound="onset_causal")
    gpt, refiner = CoSpeechGPT(sizes), Refiner(RefinerConfig(4, sound=8, motion=8, hidden=8))
    for parameter in [*gpt.parameters(), refiner.shift.out.weight, refiner.cholesky.out.weight]:
        torch.nn.init.normal_(parameter, std=0.3)
    return AngieGenerator(vq, gpt, refiner, statistics, AHEAD)


def speech(seed: int, other: int) -> Speech:
    """Features of chance, those from token `CHANGED` on by another seed."""
    parts = {}
    for name, shape in (("onset_causal", (TOKENS, 114)), ("mfcc", (TOKENS * 8, 28, 12))):
        one, two = (np.random.default_rng(s).normal(size=shape) for s in (seed, other))
        first = CHANGED * (8 if name == "mfcc" else 1)
        parts[name] = np.concatenate([one[:first], two[first:]]).astype(np.float32)
    parts["voice_causal"] = np.ones(TOKENS, np.float32)
    return Speech.of_features(parts, TOKENS * 8)


def test_frames_before_the_look_ahead_stay(generator, make_clip):
    start = make_clip(8, 1).motion[:1]
    one, two = (
        generator.generate(speech(1, other), start, TOKENS * 8, greedy=True).vector()
        for other in (2, 3)
    )
    settled = (CHANGED - 2) * 8  # refiner and decoder each look a token ahead
    assert torch.allclose(one[:settled], two[:settled], atol=1e-5)
    assert not torch.allclose(one[settled : settled + 16], two[settled : settled + 16], atol=1e-3)


def test_how_far_it_looks_ahead_is_told(generator):
    assert generator.lookahead == pytest.approx(0.94)
    assert generator.features == ("onset_causal", "mfcc", "voice_causal")

    def changed(**settings):
        return dataclasses.replace(generator, config=dataclasses.replace(AHEAD, **settings))

    assert changed(refine=False).lookahead == pytest.approx(0.62)
    assert changed(blend="hann").lookahead is None
    assert changed(bounding="auto").lookahead is None
    assert changed(sampling=Sampling("greedy")).lookahead is None


def test_decoded_frames_do_not_depend_on_codes_long_before_or_two_tokens_ahead(generator):
    codes = torch.randint(32, (2, 40), generator=torch.Generator().manual_seed(0))
    whole = generator.vq.decode_chunked(codes, "ahead")
    assert whole.shape == (320, 20)
    later = codes.clone()
    later[:, 22:] = (later[:, 22:] + 1) % 32
    assert torch.allclose(generator.vq.decode_chunked(later, "ahead")[:168], whole[:168], atol=1e-5)
    # token 13 of the rest is token 20: windows of it and of the one before begin after token 7
    rest = generator.vq.decode_chunked(codes[:, 7:], "ahead")
    assert torch.allclose(rest[13 * 8 :], whole[20 * 8 :], atol=1e-5)


def test_refined_frames_do_not_depend_on_what_lies_long_before(generator):
    torch.manual_seed(1)
    mfcc, pattern = torch.randn(300, 28, 12), torch.randn(300, 20)
    whole = generator.refiner.refine(mfcc, pattern, blend="ahead")
    rest = generator.refiner.refine(mfcc[80:], pattern[80:], blend="ahead")
    assert whole.shape == (300, 20) and torch.allclose(rest[96:], whole[176:], atol=1e-5)
    later = pattern.clone()
    later[200:] += 1  # token 25; frames of token 23 see the end of token 24
    changed = generator.refiner.refine(mfcc, later, blend="ahead")
    assert torch.allclose(changed[:192], whole[:192], atol=1e-5)
    assert not torch.allclose(changed[192:200], whole[192:200], atol=1e-3)


def test_sizes_that_do_not_fit_the_sound_are_told():
    from angie.config import override, parse_overrides, preset
    from data_prep.errors import BadInput

    with pytest.raises(BadInput, match="onset is 114 for sound=onset_causal"):
        override(preset("lite"), parse_overrides(["gpt.sound=onset_causal"]))
    both = parse_overrides(["gpt.sound=onset_causal", "gpt.onset=114"])
    assert override(preset("lite"), both).settings("angie").gpt.onset == 114
