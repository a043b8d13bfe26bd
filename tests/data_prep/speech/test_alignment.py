"""Words are laid over voiced time by their syllables, and phrases end at pauses."""

import numpy as np
import pytest

from data_prep.speech.transcript import align, syllables, voiced


def sound(*stretches: tuple[float, float], seconds: float) -> np.ndarray:
    """A hum in given stretches of seconds, over faint noise."""
    samples = 1e-4 * np.random.default_rng(0).standard_normal(round(seconds * 16000))
    for start, end in stretches:
        k = np.arange(round(start * 16000), round(end * 16000))
        samples[k] = 0.2 * np.sin(k * 0.4)
    return samples.astype(np.float32)


def test_voice_is_found_without_clicks_and_with_its_short_breaks() -> None:
    # a break of 50 ms is filled, a click of 40 ms dropped
    samples = sound((0.5, 1.0), (1.05, 2.0), (2.5, 2.54), (3.0, 3.5), seconds=4.0)
    assert voiced(samples) == [
        (pytest.approx(0.5), pytest.approx(2.0)),
        (pytest.approx(3.0), pytest.approx(3.5)),
    ]
    assert voiced(np.zeros(16000)) == [] and voiced(np.zeros(10)) == []


def test_syllables_are_groups_of_vowels() -> None:
    words = {"you": 1, "speaker": 2, "Évident": 3, "banana,": 3, "hmm": 1, "1984": 1, "говорить": 3}
    assert {word: syllables(word) for word in words} == words


def test_words_share_voiced_time_by_syllables() -> None:
    samples = sound((1.0, 2.0), (3.0, 4.0), seconds=5.0)
    words = align("one banana go on", samples)  # o-ne: 2, then 3, 1, 1 of 7 in 2 s voiced
    times = [(w.word, w.start, w.end) for w in words]
    unit = 2 / 7
    assert times == [
        ("one", pytest.approx(1.0), pytest.approx(1 + 2 * unit, abs=1e-3)),
        # 0.571 to 1.429 s of voiced time: its middle, 1.0, is where the second stretch begins
        ("banana", pytest.approx(3.0), pytest.approx(2 + 5 * unit, abs=1e-3)),
        ("go", pytest.approx(2 + 5 * unit, abs=1e-3), pytest.approx(2 + 6 * unit, abs=1e-3)),
        ("on", pytest.approx(2 + 6 * unit, abs=1e-3), pytest.approx(4.0)),
    ]


def test_a_phrase_ends_at_the_nearest_pause() -> None:
    samples = sound((1.0, 2.0), (3.0, 4.0), seconds=5.0)
    # by syllables "No," would end after 0.5 s of voiced time; the pause is 0.5 s further
    words = align("No, go on up", samples)
    assert (words[0].start, words[0].end) == (pytest.approx(1.0), pytest.approx(2.0))
    assert [w.start for w in words[1:]] == pytest.approx([3.0, 3 + 1 / 3, 3 + 2 / 3], abs=2e-3)
    samples = sound((1.0, 3.0), (4.0, 6.0), seconds=7.0)
    far = align("No, go on up and off we walk again in all our hats", samples)
    assert far[0].end < 1.5  # a pause more than a second of voice away has nothing to do with it


def test_silence_gives_no_words() -> None:
    assert align("hello there", np.zeros(32000, np.float32)) == []
    assert align("...", sound((0.5, 1.0), seconds=2.0)) == []
