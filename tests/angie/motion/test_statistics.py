import numpy as np
import pytest
import torch

from angie.motion.clips import MotionClip
from angie.motion.statistics import BEAT_COLUMN, MotionStatistics, measure
from data_prep.errors import BadInput
from data_prep.speech.features import Speech
from mraa.motion import Motion


def still_but_one(speaker: str, offset: float) -> MotionClip:
    """Sixteen frames of six regions; region 2 steps 0, 1, 0, 1 ... along x."""
    shift = torch.full((16, 6, 2), offset)
    shift[1::2, 2, 0] += 1
    cholesky = torch.full((16, 6, 3), 0.1)
    features = {"onset": np.ones((2, 426), np.float32), "mfcc": np.ones((16, 28, 12), np.float32)}
    speech = Speech.of_features(features, 16)
    return MotionClip(speaker, speaker, Motion(shift, cholesky), speech)


def test_scales_of_a_hand_worked_motion():
    statistics = measure([still_but_one("ada", 0.0), still_but_one("bob", 5.0)])
    # deltas of the moving channel: +1 eight times and -1 seven times, in two clips
    mean = 1 / 15
    assert statistics.delta_scale[4].item() == pytest.approx((1 - mean**2) ** 0.5)
    assert statistics.delta_scale[0].item() == pytest.approx(1e-5)
    # displacement from each speaker's own rest: +-1/2, whatever the offset of the speaker
    assert statistics.pose_scale[4].item() == pytest.approx(0.5)
    assert statistics.rest_of("bob")[:5].tolist() == [5, 5, 5, 5, 5.5]
    assert statistics.low[4].item() == pytest.approx(-0.5)
    assert statistics.high[4].item() == pytest.approx(0.5)
    assert torch.allclose(statistics.diagonal_low, torch.tensor(0.1))
    # one region exceeds the mean energy; at least four are active
    assert statistics.active.sum() == 4 and statistics.active[2]


def test_an_unknown_speaker_is_refused_with_the_nearest_name(statistics):
    with pytest.raises(BadInput, match="did you mean 'ada'"):
        statistics.rest_of("adda")
    with pytest.raises(BadInput, match="known: ada, bob"):
        statistics.rest_of("zzzzzz")


def test_onset_is_standardised_and_clamped_but_beats_stay_raw(clips, statistics):
    onset = torch.from_numpy(np.concatenate([clip.speech["onset"] for clip in clips]))
    standard = statistics.standard_onset(onset)
    assert BEAT_COLUMN == 41  # after 20 cepstra, 20 deltas and the onset strength
    assert torch.equal(standard[:, BEAT_COLUMN], onset[:, BEAT_COLUMN])
    others = torch.cat([standard[:, :BEAT_COLUMN], standard[:, BEAT_COLUMN + 1 :]], dim=1)
    assert others.mean(0).abs().max() < 1e-2
    assert (others.std(0) - 1).abs().max() < 2e-2
    assert statistics.standard_onset(onset + 1e6)[:, 0].max() == 5


def test_mfcc_is_standardised_per_coefficient(clips, statistics):
    mfcc = torch.from_numpy(np.concatenate([clip.speech["mfcc"] for clip in clips]))
    standard = statistics.standard_mfcc(mfcc)
    assert standard.mean((0, 1)).abs().max() < 1e-3
    assert (standard.std((0, 1)) - 1).abs().max() < 1e-3


def test_statistics_read_back(statistics, tmp_path):
    statistics.save(tmp_path / "statistics.safetensors")
    again = MotionStatistics.load(tmp_path / "statistics.safetensors")
    assert again.speakers == statistics.speakers
    for name in ("rest", "delta_scale", "active", "onset_scale", "diagonal_high"):
        assert torch.equal(getattr(again, name), getattr(statistics, name))


def test_a_file_that_is_no_statistics_is_refused(tmp_path):
    (tmp_path / "a.safetensors").write_bytes(b"nothing")
    for name in ("a.safetensors", "b.safetensors"):
        with pytest.raises(BadInput, match=name):
            MotionStatistics.load(tmp_path / name)


def test_no_clips_is_bad_input():
    with pytest.raises(BadInput, match="no training clip"):
        measure([])
