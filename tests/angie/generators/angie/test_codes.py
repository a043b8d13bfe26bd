import copy
import dataclasses
import math

import pytest
import torch

from angie.generators.angie.channels import Channels
from angie.generators.angie.codes import (
    correlation,
    decoding_errors,
    encode_whole,
    encode_windows,
    patterns,
    perplexity,
    reconstruction,
    window_codes,
)
from angie.generators.angie.report import vq_report
from angie.generators.angie.tokenizer import VQConfig, VQMotionExtractor
from angie.motion.windows import MotionWindows


@pytest.fixture(scope="module")
def vq() -> VQMotionExtractor:
    torch.manual_seed(0)
    vq = VQMotionExtractor(VQConfig(regions=4, width=8, codes=16, code_width=8)).train()
    vq(torch.randn(8, 96, 20))
    return vq.eval()


@pytest.fixture(scope="module")
def of_clips(vq) -> VQMotionExtractor:
    """The same weights, used in the context of clips."""
    other = copy.deepcopy(vq)
    other.config = dataclasses.replace(vq.config, context="clip")
    return other


def test_perplexity_of_known_codes():
    assert perplexity(torch.tensor([[3, 3], [3, 3]])) == pytest.approx(1)
    assert perplexity(torch.tensor([0, 1, 2, 3])) == pytest.approx(4)
    half = -0.75 * math.log(0.75) - 0.25 * math.log(0.25)
    assert perplexity(torch.tensor([5, 5, 5, 9])) == pytest.approx(math.exp(half))


def test_correlation_of_known_motion():
    true = torch.randn(3, 50, 4)
    assert correlation(2 * true + 1, true) == pytest.approx(1)
    assert correlation(-true, true) == pytest.approx(-1)
    assert abs(correlation(torch.randn(3, 500, 4), torch.randn(3, 500, 4))) < 0.1
    assert correlation(torch.zeros(1, 5, 1), true[:1, :5, :1]) == 0


def test_a_perfect_extractor_has_no_error(vq, clips, statistics, monkeypatch):
    windows = MotionWindows(clips[:2], statistics)
    values = Channels.of(statistics).normalise(windows.stack("poses", 0, len(windows)))
    monkeypatch.setattr("angie.generators.angie.codes.decode_windows", lambda *_: values)
    scores = reconstruction(vq, windows)
    assert scores["error"] == pytest.approx(0, abs=1e-6)
    assert scores["correlation"] == pytest.approx(1, abs=1e-3)
    assert 1 <= scores["shift_perplexity"] <= scores["shift_used"] <= 16
    assert scores["joint_perplexity"] >= scores["shift_perplexity"] - 1e-6


def test_the_two_ways_of_decoding_are_compared_on_long_clips(vq, clips, statistics):
    channels = Channels.of(statistics)
    errors = decoding_errors(vq, clips[:2], channels)
    assert set(errors) == {"full", "chunked"} and errors["full"] != errors["chunked"]
    short = MotionWindows(clips[:1], statistics).clips[0]
    short = type(short)(short.name, short.speaker, short.motion[:150], short.speech)
    assert decoding_errors(vq, [short], channels) == {}


def test_the_report_names_the_frequent_pairs(vq, clips, statistics):
    windows = MotionWindows(clips[:3], statistics)
    report = vq_report(vq, windows, None)
    counts = [count for *_, count in report["pairs"]]
    assert counts == sorted(counts, reverse=True) and sum(counts) <= 12 * len(windows)
    assert "held_out" not in report and report["training"]["error"] > 0


def test_codes_of_clips_are_cut_out_of_one_pass(vq, of_clips, clips, statistics):
    windows = MotionWindows(clips[:2], statistics, stride=8)
    codes = window_codes(of_clips, windows)
    channels = Channels.of(statistics)
    for row, (index, first) in zip(codes, windows.places, strict=True):
        whole = encode_whole(vq, clips[index].motion.vector(), channels)
        assert whole.shape == (2, 32)  # 250 frames are 31 tokens and 2 frames
        assert torch.equal(row, whole[:, first // 8 : first // 8 + 12])
    alone = encode_windows(vq, windows)
    assert torch.equal(window_codes(vq, windows), alone) and not torch.equal(codes, alone)
    assert not torch.equal(codes[:, :, 0], alone[:, :, 0])  # where zeros pad a window
    with pytest.raises(ValueError, match="begin on tokens"):
        window_codes(of_clips, MotionWindows(clips[:1], statistics, stride=5))


def test_patterns_of_clips_are_cut_out_of_what_is_decoded(vq, of_clips, clips, statistics):
    windows = MotionWindows(clips[:2], statistics, stride=5)  # between tokens too
    made = patterns(of_clips, windows)
    assert made.shape == (len(windows), 96, 20)
    decoded = vq.decode_chunked(encode_whole(vq, clips[1].motion.vector(), Channels.of(statistics)))
    places = [place for place, (index, _) in enumerate(windows.places) if index == 1]
    for place in (places[0], places[3], places[-1]):
        first = windows.places[place][1]
        assert torch.equal(made[place], decoded[first : first + 96])


def test_in_the_context_of_clips_a_token_counts_once(of_clips, clips, statistics):
    windows = MotionWindows(clips[:3], statistics, stride=5)
    pairs = vq_report(of_clips, windows, None)["pairs"]
    assert sum(count for *_, count in pairs) <= 3 * 32
    errors = decoding_errors(of_clips, clips[:2], Channels.of(statistics))
    assert set(errors) == {"full", "chunked"}
