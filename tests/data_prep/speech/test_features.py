"""Speech features: the stated columns in the stated order, and windows centred on their frames."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import soxr

from data_prep.speech.features import Speech, register_feature
from data_prep.speech.spectra import (
    _percussive,
    cepstra,
    load_librosa,
    mfcc_windows,
    onset_rows,
    onset_times,
)
from data_prep.speech.words import Word


def bursts(seconds: float, every: float = 0.5, seed: int = 0) -> np.ndarray:
    """Noise bursts of 80 ms at regular times, like syllables."""
    t = np.arange(round(seconds * 16000)) / 16000
    noise = np.random.default_rng(seed).standard_normal(len(t))
    return (0.3 * noise * (t % every < 0.08)).astype(np.float32)


@pytest.mark.parametrize(
    ("samples", "frames", "tokens"),
    [(1, 1, 1), (640, 1, 1), (641, 2, 1), (5120, 8, 1), (5121, 9, 2), (176000, 275, 35)],
)
def test_sizes_cover_the_sound(samples: int, frames: int, tokens: int) -> None:
    speech = Speech(bursts(12)[:samples])
    assert speech["onset"].shape == (tokens, 426)
    assert speech["mfcc"].shape == (frames, 28, 12)
    assert (
        speech["onset"].dtype == speech["mfcc"].dtype == speech["onset_times"].dtype == np.float32
    )
    assert np.isfinite(speech["onset"]).all() and np.isfinite(speech["mfcc"]).all()


def test_silence_is_finite_and_has_no_beats() -> None:
    speech = Speech(np.zeros(48000, np.float32))
    assert np.isfinite(speech["onset"]).all() and np.isfinite(speech["mfcc"]).all()
    assert not speech["onset"][:, 40:42].any()
    assert len(speech["onset_times"]) == 0


@pytest.mark.parametrize(("seconds", "every"), [(20.0, 0.5), (37.3, 1.1), (4.0, 0.7), (90.0, 1.9)])
def test_onset_columns_are_those_of_librosa(
    seconds: float, every: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    librosa = load_librosa()
    samples = bursts(seconds, every)
    slow = soxr.resample(samples, 16000, 1600)
    mel = librosa.feature.melspectrogram(y=slow, sr=1600)
    mfcc = librosa.feature.mfcc(S=librosa.power_to_db(mel, ref=np.max), n_mfcc=20)
    strength = librosa.onset.onset_strength(
        y=librosa.effects.percussive(slow), sr=1600, aggregate=np.median
    )
    tempogram = librosa.feature.tempogram(onset_envelope=strength, sr=1600)
    beat = np.zeros(len(strength))
    beat[librosa.beat.beat_track(onset_envelope=strength, sr=1600)[1]] = 1
    monkeypatch.setattr("data_prep.speech.spectra._BLOCK", 64)  # sound of several blocks
    rows = onset_rows(samples)
    n = len(rows)
    assert n == -(-len(samples) // 5120)
    np.testing.assert_allclose(rows[:, :20], mfcc.T[:n], rtol=1e-4, atol=1e-3)
    np.testing.assert_allclose(
        rows[:, 20:40], librosa.feature.delta(mfcc, width=3).T[:n], atol=1e-3
    )
    np.testing.assert_allclose(rows[:, 40], strength[:n], rtol=1e-4, atol=1e-3)
    np.testing.assert_array_equal(rows[:, 41], beat[:n])
    assert rows[:, 41].any()
    np.testing.assert_allclose(rows[:, 42:], tempogram.T[:n], atol=1e-4)


def test_onset_times_are_those_of_librosa(monkeypatch: pytest.MonkeyPatch) -> None:
    samples = bursts(12, 0.37) + 0.01 * bursts(12, 0.08, seed=1)
    expected = load_librosa().onset.onset_detect(y=samples, sr=16000, units="time")
    assert len(expected) > 20
    monkeypatch.setattr("data_prep.speech.spectra._BLOCK", 64)
    np.testing.assert_allclose(onset_times(samples), expected, atol=1e-6)


def test_librosa_is_loaded_when_onsets_are_asked_for_and_compiles_nothing(tmp_path: Path) -> None:
    code = (
        "import sys, numpy; from data_prep.speech.features import Speech; "
        "speech = Speech(numpy.ones(9999)); speech['mfcc']; "
        "assert not {'librosa', 'numba', 'torch'} & set(sys.modules), sys.modules.keys(); "
        "from data_prep.speech.spectra import load_librosa; load_librosa().onset.onset_detect; "
        "assert not {'sklearn', 'torch'} & set(sys.modules), sys.modules.keys()"
    )
    cache = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    subprocess.run([sys.executable, "-c", code], check=True, env=cache)
    assert not list(tmp_path.rglob("*.nb*"))


def test_percussive_part_is_that_of_librosa() -> None:
    effects = load_librosa().effects
    samples = bursts(1, 0.25) + 0.1 * np.sin(np.arange(16000, dtype=np.float32) / 3)
    expected = effects.percussive(samples)
    assert 0.1 < np.square(expected).sum() / np.square(samples).sum() < 0.9
    np.testing.assert_allclose(_percussive(samples), expected, atol=1e-7)


def test_short_sound_is_mirrored_to_what_the_recipe_needs() -> None:
    short = bursts(0.6)
    mirrored = np.pad(short, (0, 25600 - len(short)), mode="reflect")
    np.testing.assert_array_equal(onset_rows(short), onset_rows(mirrored)[:2])


def test_mfcc_window_is_centred_on_its_frame() -> None:
    frame = 30
    samples = np.zeros(64 * 640, np.float32)
    samples[frame * 640 + 320] = 0.9
    windows = mfcc_windows(samples)
    # Away from the click every row is that of silence.
    rows = np.abs(windows - windows[0, 0]).sum(axis=2) > 1e-3
    assert set(np.flatnonzero(rows[frame])) <= {12, 13, 14, 15}
    assert rows[frame].any()
    assert set(np.flatnonzero(rows[frame + 1])) <= {8, 9, 10, 11}
    assert set(np.flatnonzero(rows[frame - 3])) <= {24, 25, 26, 27}
    assert rows[frame - 3].any() and not rows[frame - 4].any() and not rows[frame + 4].any()


def test_windows_of_neighbouring_frames_share_rows() -> None:
    windows = mfcc_windows(bursts(2))
    np.testing.assert_array_equal(windows[1:, :24], windows[:-1, 4:])


def test_cepstrum_of_a_click_by_hand() -> None:
    # A single 1 at the start of a window: pre-emphasis makes it 1, -0.97, whose spectrum is
    # |1 - 0.97 exp(-i w)|^2 / 512 = (1 + 0.97^2 - 1.94 cos w) / 512.
    samples = np.zeros(400)
    samples[0] = 1.0
    power = (1 + 0.97**2 - 1.94 * np.cos(2 * np.pi * np.arange(257) / 512)) / 512
    row = cepstra(samples, 1)[0]
    assert row[0] == pytest.approx(np.log(power.sum()))
    mel = 2595 * np.log10(1 + 8000 / 700)
    edges = np.floor(513 * 700 * (10 ** (np.linspace(0, mel, 28) / 2595) - 1) / 16000).astype(int)
    logs = []
    for a, b, c in zip(edges, edges[1:], edges[2:], strict=False):
        weight = [(k - a) / (b - a) for k in range(a, b)] + [(c - k) / (c - b) for k in range(b, c)]
        logs.append(np.log(np.dot(weight, power[a:c])))
    for k in (1, 5, 12):
        basis = np.cos(np.pi * k * (2 * np.arange(26) + 1) / 52) * np.sqrt(2 / 26)
        lift = 1 + 11 * np.sin(np.pi * k / 22)
        assert row[k] == pytest.approx(lift * np.dot(basis, logs))


def test_onset_times_are_where_the_bursts_are() -> None:
    times = onset_times(bursts(4, every=1.0))
    for burst in (1.0, 2.0, 3.0):
        assert np.abs(times - burst).min() < 0.05


def test_bad_shapes_are_refused() -> None:
    for bad in (np.zeros(0, np.float32), np.zeros((100, 2), np.float32)):
        with pytest.raises(ValueError, match="must be"):
            Speech(bad)


def test_features_are_computed_once_when_first_asked_for() -> None:
    speech = Speech(bursts(2), [Word("one", 0.0, 0.5)])
    assert (speech.frames, speech.tokens, speech.seconds) == (50, 7, 2.0)
    assert speech.words == (Word("one", 0.0, 0.5),) and "mfcc" not in speech
    assert speech["mfcc"] is speech["mfcc"]
    speech.forget_samples()
    assert len(speech["mfcc"]) == 50 and "mfcc" in speech
    with pytest.raises(ValueError, match="no samples"):
        speech["onset"]
    with pytest.raises(KeyError, match="'tone'; known are onset, mfcc, onset_times"):
        speech["tone"]
    with pytest.raises(ValueError, match="0 frames"):
        Speech.of_features({}, 0)


def test_names_of_features_are_not_taken_twice() -> None:
    with pytest.raises(ValueError, match="'mfcc'"):
        register_feature("mfcc", len)
    with pytest.raises(ValueError, match="no name"):
        register_feature("a/b", len)


def test_the_energy_is_left_out_of_the_windows() -> None:
    # twice as loud adds one number to all bands, which is in the first cepstrum alone
    rng = np.random.default_rng(0)
    samples = (0.1 * rng.normal(size=8000)).astype(np.float32)
    once, twice = mfcc_windows(samples), mfcc_windows(2 * samples)
    np.testing.assert_allclose(once[5], twice[5], atol=1e-3)
    assert np.abs(once[5]).max() > 1
