import pytest
import torch

from angie.motion.windows import cross_fade, window_starts


def test_windows_cover_to_the_very_end():
    assert window_starts(10, 4, 2) == [0, 2, 4, 6]
    assert window_starts(11, 4, 2) == [0, 2, 4, 6, 7]
    assert window_starts(3, 4, 2) == [0]
    with pytest.raises(ValueError, match="cannot cover 0"):
        window_starts(0, 4, 2)


@pytest.mark.parametrize("how", [{"fade": 4}, {"fade": 16}, {"blend": "hann"}, {"blend": "ahead"}])
@pytest.mark.parametrize("length", [1, 5, 96, 97, 150, 1000])
def test_windows_that_agree_are_reproduced(length, how):
    truth = torch.randn(length, 3)
    whole = min(96, length)

    def compute(starts, size=whole):
        return torch.stack([truth[at : at + size] for at in starts])

    assert torch.allclose(cross_fade(length, 96, compute, at_once=2, **how), truth, atol=1e-5)


def test_the_fade_is_linear():
    # windows 0 and 1 overlap in 4 frames: weights (4,1), (3,2), (2,3), (1,4) out of 5
    def compute(starts):
        return torch.stack([torch.full((8, 1), float(at > 0)) for at in starts])

    blended = cross_fade(12, 8, compute, fade=4)[:, 0]
    assert torch.allclose(blended[4:8], torch.tensor([0.2, 0.4, 0.6, 0.8]))
    assert (blended[:4] == 0).all() and (blended[8:] == 1).all()


def test_a_short_fade_is_in_the_middle_of_the_overlap():
    # windows 0 and 1 overlap in 4 frames, of which the middle two are weighted (2,1) and (1,2)
    def compute(starts):
        return torch.stack([torch.full((8, 1), float(at > 0)) for at in starts])

    blended = cross_fade(12, 8, compute, fade=2)[:, 0]
    assert torch.allclose(blended[4:8], torch.tensor([0, 1 / 3, 2 / 3, 1]), atol=1e-5)
    assert (blended[:4] == 0).all() and (blended[8:] == 1).all()


@pytest.mark.parametrize("length", [192, 193, 200, 239, 241, 264])
def test_the_last_window_fades_as_shortly_however_far_it_reaches_back(length):
    places = {at: number for number, at in enumerate(window_starts(length, 96, 48))}

    def compute(starts):
        return torch.stack([torch.full((96, 1), float(places[at])) for at in starts])

    blended = cross_fade(length, 96, compute, fade=16)[:, 0]
    assert (blended.diff() >= -1e-6).all() and blended[-1] == len(places) - 1
    between = (blended != blended.round()).double()
    assert between.sum() <= 17 * (len(places) - 1)
    longest = max(len(run) for run in "".join("x" if b else " " for b in between).split())
    assert longest <= 17


def test_ahead_windows_end_a_token_later_and_fade_within_a_token():
    # of each window its end, 8 times the number of its token and 16, but for the last one
    def compute(starts, size):
        return torch.stack([torch.full((size, 1), float(at + size)) for at in starts])

    made = cross_fade(40, 24, compute, "ahead")[:, 0]
    assert (made[:8] == 16).all() and made[8:16].tolist() == [16.5 + i for i in range(8)]
    assert made[24:32].tolist() == [32.5 + i for i in range(8)] and (made[32:] == 40).all()


def test_an_unknown_blend_is_refused():
    with pytest.raises(ValueError, match="blend is one of linear, hann"):
        cross_fade(100, 96, lambda starts: torch.zeros(len(starts), 96, 1), "Hann")


def test_no_frame_is_averaged_more_than_another_under_hann():
    # windows of independent noise: the variance of the result is the sum of squared weights
    torch.manual_seed(0)

    def compute(starts):
        return torch.randn(len(starts), 96, 20000)

    for blend, steady in (("hann", True), ("linear", False)):
        spread = cross_fade(480, 96, compute, blend)[96:-96].std(dim=1)
        assert (spread.max() < 1.05 * spread.min()) == steady
    assert abs(spread.max() - 1) < 0.05  # linear: where there is one window alone
