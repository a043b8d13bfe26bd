import math

import pytest
import torch

from angie.patterns import correlation, decoding_errors, perplexity, reconstruction
from angie.quantisation import Channels
from angie.reports import vq_report
from angie.vq import VQConfig, VQMotionExtractor
from angie.windows import MotionWindows


@pytest.fixture(scope="module")
def vq() -> VQMotionExtractor:
    torch.manual_seed(0)
    vq = VQMotionExtractor(VQConfig(regions=4, width=8, codes=16, code_width=8)).train()
    vq(torch.randn(8, 96, 20))
    return vq.eval()


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
    monkeypatch.setattr("angie.patterns.decode_windows", lambda *_: values)
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
    short = type(short)(short.name, short.speaker, short.motion[:150], short.features)
    assert decoding_errors(vq, [short], channels) == {}


def test_the_report_names_the_frequent_pairs(vq, clips, statistics):
    windows = MotionWindows(clips[:3], statistics)
    report = vq_report(vq, windows, None)
    counts = [count for *_, count in report["pairs"]]
    assert counts == sorted(counts, reverse=True) and sum(counts) <= 12 * len(windows)
    assert "held_out" not in report and report["training"]["error"] > 0
