"""The phantom's speech by eSpeak NG, where it is installed."""

import numpy as np
import pytest

from data_prep.errors import BadInput
from data_prep.phantom import espeak
from data_prep.phantom.presenters import presenter
from data_prep.phantom.script import LEXICON, Phrase, script
from data_prep.phantom.speech import Speech

pytestmark = pytest.mark.skipif(not espeak.installed(), reason="eSpeak NG is not installed")


@pytest.fixture(scope="module")
def phrases() -> list[Phrase]:
    return script(20, 1.0, np.random.default_rng(0))


@pytest.fixture(scope="module")
def talk(phrases: list[Phrase]) -> Speech:
    return espeak.speak(phrases, presenter(0).voice, np.random.default_rng(1))


def level(speech: Speech, start: float, end: float) -> float:
    part = speech.samples[round(start * speech.rate) : round(end * speech.rate)]
    return float(np.sqrt(np.mean(part**2)))


def test_words_are_said_in_order_with_their_stress(phrases: list[Phrase], talk: Speech) -> None:
    assert [word.word for word in talk.words] == [w for phrase in phrases for w in phrase.words]
    before = 0.0
    for word in talk.words:
        assert before - 1e-9 <= word.start < word.end <= talk.duration
        assert all(word.start <= beat <= word.end for beat in word.beats)
        stressed = any(phone.endswith("1") for phone in LEXICON[word.word])
        assert bool(word.beats) == stressed, word
        before = word.end


def test_there_is_sound_in_words_and_none_in_pauses(talk: Speech) -> None:
    pauses = [
        level(talk, a[1] + 0.06, b[0] - 0.06)
        for a, b in zip(talk.phrases[:-1], talk.phrases[1:], strict=True)
    ]
    assert min(level(talk, word.start, word.end) for word in talk.words) > 10 * max(pauses)


def test_stressed_vowels_rise_where_they_are_said(talk: Speech) -> None:
    rises = [level(talk, b + 0.01, b + 0.07) / level(talk, b - 0.06, b) for b in talk.beats]
    assert np.median(rises) > 1.5


def test_it_says_the_same_twice(talk: Speech, phrases: list[Phrase]) -> None:
    again = espeak.speak(phrases, presenter(0).voice, np.random.default_rng(1))
    assert np.array_equal(talk.samples, again.samples) and talk.words == again.words


def test_a_voice_that_is_not_there_is_refused_in_one_line() -> None:
    request = {"voice": "zz-nowhere", "pitch": 50, "range": 50, "phrases": [("the", 140)]}
    with pytest.raises(BadInput, match="has no voice zz-nowhere.*--voice builtin"):
        espeak._answer(request)
