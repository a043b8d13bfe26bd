"""The phantom's voice: words where they are said, pitch and formants as asked for."""

import numpy as np
import pytest

from data_prep.phantom.phones import VOWELS, segments
from data_prep.phantom.presenters import Voice, presenter
from data_prep.phantom.script import _SENTENCES, _SLOTS, LEXICON, TRIGGERS, Phrase, script
from data_prep.phantom.speech import CONTROL, RATE, Controls, Speech, speak, synthesise


@pytest.fixture(scope="module")
def talk() -> Speech:
    phrases = script(25, 1.0, np.random.default_rng(0))
    return speak(phrases, presenter(0).voice, np.random.default_rng(1))


def level(speech: Speech, start: float, end: float) -> float:
    part = speech.samples[round(start * speech.rate) : round(end * speech.rate)]
    return float(np.sqrt(np.mean(part**2)))


def steady(vowel: str, pitch: float, scale: float = 1.0) -> np.ndarray:
    """One second of a vowel at a steady pitch."""
    ones = np.ones(CONTROL)
    controls = Controls(
        pitch=pitch * ones,
        voicing=ones,
        breath=0 * ones,
        friction=0 * ones,
        noise=np.tile([4000.0, 2000.0], (CONTROL, 1)),
        formants=np.tile(VOWELS[vowel][0], (CONTROL, 1)),
        broad=ones,
    )
    voice = Voice(pitch, 4, scale, 1, 0.0, 0.8)
    return synthesise(controls, voice, np.random.default_rng(0))


def peak(samples: np.ndarray, low: float, high: float, smooth: float = 120) -> float:
    """Frequency of the largest value of the smoothed spectrum between two bounds, hertz."""
    power = np.abs(np.fft.rfft(samples * np.hanning(len(samples)))) ** 2
    hertz = np.fft.rfftfreq(len(samples), 1 / RATE)
    width = int(smooth / hertz[1])
    power = np.convolve(power, np.hanning(width), "same")
    inside = (hertz >= low) & (hertz <= high)
    return float(hertz[inside][np.argmax(power[inside])])


def test_the_lexicon_has_every_word_of_the_script() -> None:
    said = {word for slot in _SLOTS.values() for word in slot} | set(TRIGGERS)
    for sentence in _SENTENCES:
        tokens = sentence.replace(",", " ").replace(".", " ").split()
        said |= {token for token in tokens if not token.startswith("[")}
    assert said <= set(LEXICON) and len(LEXICON) >= 150


def test_words_that_call_for_strokes_are_stressed_when_said() -> None:
    assert all(any(phone.endswith("1") for phone in LEXICON[word]) for word in TRIGGERS)


def test_every_phone_of_the_lexicon_can_be_said() -> None:
    for word, phones in LEXICON.items():
        parts = segments(phones, None)
        assert all(part.duration > 0 for part in parts), word
        nuclei = [part for part in parts if part.nucleus]
        assert len(nuclei) == sum(phone[-1] in "01" for phone in phones), word


def test_words_are_in_order_and_inside_the_sound(talk: Speech) -> None:
    assert np.abs(talk.samples).max() <= 1
    assert len(talk.samples) % (RATE // 25) == 0
    before = 0.0
    for word in talk.words:
        assert before <= word.start < word.end <= talk.duration
        assert all(word.start <= beat < word.end for beat in word.beats)
        before = word.end


def test_there_is_sound_in_words_and_none_in_pauses(talk: Speech) -> None:
    pauses = [
        level(talk, a[1] + 0.06, b[0] - 0.06)
        for a, b in zip(talk.phrases[:-1], talk.phrases[1:], strict=True)
    ]
    quietest = min(level(talk, word.start, word.end) for word in talk.words)
    assert quietest > 50 * max(pauses)


def test_stressed_vowels_rise_where_they_are_said(talk: Speech) -> None:
    rises = [level(talk, b + 0.01, b + 0.07) / level(talk, b - 0.06, b) for b in talk.beats]
    assert np.median(rises) > 1.5


def test_pauses_last_as_the_script_says() -> None:
    phrases = [Phrase(("the", "river"), 0.4, False), Phrase(("the", "garden"), 2.5, True)]
    said = speak(phrases, presenter(1).voice, np.random.default_rng(0))
    (_, first), (second, end) = said.phrases
    assert second - first == pytest.approx(0.4)
    assert said.duration - end == pytest.approx(2.5, abs=0.05)


def test_scripts_have_pauses_and_long_silences() -> None:
    phrases = script(60, 1.0, np.random.default_rng(3))
    pauses = np.array([phrase.pause for phrase in phrases])
    assert pauses.min() >= 0.3 and pauses.max() <= 3.0
    assert ((pauses >= 2) & (pauses <= 3)).sum() >= 2


def test_the_pitch_is_the_one_asked_for() -> None:
    for pitch in (100.0, 200.0):
        samples = steady("AH", pitch)
        samples = samples - samples.mean()
        lags = np.arange(RATE // 400, RATE // 60)
        score = [np.dot(samples[:-lag], samples[lag:]) for lag in lags]
        assert RATE / lags[int(np.argmax(score))] == pytest.approx(pitch, rel=0.04)


def test_vowels_have_their_formants() -> None:
    assert peak(steady("IY", 90), 150, 600) == pytest.approx(VOWELS["IY"][0][0], abs=80)
    assert peak(steady("IY", 90), 1500, 2600) == pytest.approx(VOWELS["IY"][0][1], abs=120)
    assert peak(steady("AA", 90), 400, 900) == pytest.approx(VOWELS["AA"][0][0], abs=80)
    # a smaller vocal tract raises every formant
    assert peak(steady("AA", 90, 1.2), 500, 1000) > 1.1 * peak(steady("AA", 90), 400, 900)


def test_voices_differ_and_the_seed_decides() -> None:
    phrases = [Phrase(("the", "big", "river"), 0.5, True)]
    low, high = presenter(2).voice, presenter(1).voice
    one = speak(phrases, low, np.random.default_rng(0))
    again = speak(phrases, low, np.random.default_rng(0))
    assert np.array_equal(one.samples, again.samples)
    assert high.pitch > 1.8 * low.pitch
    assert not np.array_equal(
        one.samples[:24000], speak(phrases, high, np.random.default_rng(0)).samples[:24000]
    )
