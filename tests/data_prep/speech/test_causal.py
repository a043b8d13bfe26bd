"""Features of sound as it comes: what they may know, and that they know it."""

import numpy as np
import pytest

from data_prep.rates import SAMPLE_RATE, SAMPLES_PER_TOKEN
from data_prep.speech.causal import ONSET_SIZE, onset_rows_causal, voice_causal
from data_prep.speech.features import SOUND_SIZES, Speech

AHEAD = round(0.3 * SAMPLE_RATE)
PAST = 8 * SAMPLE_RATE


@pytest.fixture(scope="module")
def sound() -> np.ndarray:
    """16 s of bursts of noise."""
    rng = np.random.default_rng(0)
    loud = np.repeat(rng.choice([0.001, 0.3], 100), SAMPLE_RATE * 16 // 100)
    return (rng.normal(size=len(loud)) * loud).astype(np.float32)


@pytest.mark.parametrize("compute", [onset_rows_causal, voice_causal])
def test_later_sound_than_the_next_300_ms_changes_nothing(sound, compute):
    rows, token = compute(sound), 30
    other = sound.copy()
    other[token * SAMPLES_PER_TOKEN + AHEAD :] = 0.5
    assert np.allclose(compute(other)[: token + 1], rows[: token + 1], atol=1e-5)
    cut = sound[: token * SAMPLES_PER_TOKEN + AHEAD]
    assert np.allclose(compute(cut)[: token + 1], rows[: token + 1], atol=1e-5)


def test_the_next_200_ms_are_heard(sound):
    other = sound.copy()
    other[30 * SAMPLES_PER_TOKEN : 30 * SAMPLES_PER_TOKEN + AHEAD] = 0
    assert np.abs(onset_rows_causal(other)[30] - onset_rows_causal(sound)[30]).max() > 0.5


@pytest.mark.parametrize("compute", [onset_rows_causal, voice_causal])
def test_what_came_more_than_8_s_before_changes_nothing(sound, compute):
    rows, first = compute(sound), 20
    later = compute(sound[first * SAMPLES_PER_TOKEN :])
    settled = PAST // SAMPLES_PER_TOKEN  # whose 8 s lie in both
    assert np.allclose(later[settled:], rows[first + settled :], atol=1e-5)
    assert len(later[settled:]) > 4


def test_a_click_is_in_the_step_of_its_time():
    samples = np.full(4 * SAMPLE_RATE, 1e-3, np.float32) * np.sin(np.arange(4 * SAMPLE_RATE))
    samples[5 * SAMPLES_PER_TOKEN + 1600] = 1.0  # 0.1 s into token 5
    strength = onset_rows_causal(samples.astype(np.float32))[5, 39:62]
    # 23 steps of 40 ms end 280 ms into the token; the click's first windows begin at 80 ms
    assert strength.argmax() == 23 - 7 + 2 and strength.max() > 10 * np.median(strength)


def test_rows_lie_within_a_few_units_and_a_steady_beat_shows(sound):
    rows = onset_rows_causal(sound)
    assert rows.shape == (50, ONSET_SIZE) and rows.dtype == np.float32
    assert np.isfinite(rows).all() and np.abs(rows).max() <= 5
    beat = 0.05 * np.random.default_rng(1).normal(size=16 * SAMPLE_RATE)
    beat *= np.arange(len(beat)) % (SAMPLE_RATE // 2) < 1600  # every half second
    rhythm = onset_rows_causal(beat.astype(np.float32))[-1, 62:112]
    assert abs(int(rhythm[5:20].argmax()) + 5 + 1 - 12.5) <= 1  # lags of 40 ms from 40 ms on


def test_voice_stands_out_of_the_noise_and_silence_has_none(sound):
    rng = np.random.default_rng(2)
    quiet = 1e-3 * rng.normal(size=8 * SAMPLE_RATE)
    quiet[4 * SAMPLE_RATE : 6 * SAMPLE_RATE] *= 100
    voiced = voice_causal(quiet.astype(np.float32))
    seconds = np.arange(len(voiced)) * 0.32
    assert voiced[(seconds > 4) & (seconds < 5.6)].all()
    assert not voiced[(seconds > 6.1)].any()
    assert not voice_causal(np.zeros(SAMPLE_RATE, np.float32)).any()


def test_they_are_features_of_speech_by_name(sound):
    speech = Speech(sound)
    for name in ("onset_causal", "voice_causal"):
        assert len(speech[name]) == speech.tokens
    assert SOUND_SIZES == {"onset": 426, "onset_causal": 114}
    assert speech["onset_causal"].shape[1] == 114
