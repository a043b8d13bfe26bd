"""Transcripts of every format give the words and times that are written in them."""

import json
from pathlib import Path

import numpy as np
import pytest

from data_prep.errors import BadInput
from data_prep.speech.transcript import find_transcript, read_transcript
from data_prep.speech.words import Word

SHARED = Path(__file__).resolve().parents[3].parent / "shared" / "data"

TWO = [Word("Good", 0.5, 0.75), Word("morning", 1.0, 1.5)]


def read(tmp_path: Path, name: str, text: str) -> list[Word]:
    (tmp_path / name).write_text(text, encoding="utf-8")
    return read_transcript(tmp_path / name).words


def entry(key: str, start: str, end: str) -> list[dict[str, object]]:
    return [{key: w.word, start: w.start, end: w.end} for w in TWO]


@pytest.mark.parametrize(
    "content",
    [
        entry("word", "start", "end"),
        entry("text", "start", "end"),
        [{"content": "Good morning", "start": 0.5, "words": entry("word", "start", "end")}],
        {"text": "Good", "segments": [{"start": 0, "words": entry("text", "start", "end")}]},
        {"t": "all", "b": 0, "d": 2, "w": [
            {"b": 0.0, "d": 0.5, "t": "<sil>"},
            {"b": 0.5, "d": 0.25, "t": "Good(2)"},
            {"b": 1.0, "d": 0.5, "t": "morning"},
        ]},
        {"result": [{"conf": 1, **word} for word in entry("word", "start", "end")], "text": ""},
        {"words": [
            {"case": "success", "word": "Good", "start": 0.5, "end": 0.75},
            {"case": "not-found-in-audio", "word": "very"},
            {"case": "success", "word": "morning", "start": 1.0, "end": 1.5},
        ]},
        {"fragments": [
            {"begin": "0.500", "end": "0.75", "lines": ["Good"]},
            {"begin": "1.000", "end": "1.5", "lines": ["morning"]},
        ]},
    ],
)  # fmt: skip
def test_json_of_any_shape(tmp_path: Path, content: object) -> None:
    assert read(tmp_path, "talk.json", json.dumps(content)) == TWO


def test_cues_are_spread_by_the_lengths_of_the_words(tmp_path: Path) -> None:
    content = {"segments": [{"text": "A good-looking day!", "start": 10.0, "end": 17.5}]}
    words = read(tmp_path, "talk.json", json.dumps(content))  # 1, 11 and 3 letters in 7.5 s
    assert words == [
        Word("A", 10.0, 10.5),
        Word("good-looking", 10.5, 16.0),
        Word("day!", 16.0, 17.5),
    ]


def test_srt(tmp_path: Path) -> None:
    text = (
        "\ufeff1\r\n00:00:01,000 --> 00:00:03,000\r\n<i>two</i> &amp; [music]\r\nfour\r\n\r\n"
        "2\r\n01:00:00,500 --> 01:00:01,000\r\nno\r\n\r\n"
        "3\r\n01:00:01,000 --> 01:00:02,000\r\nno\r\n"
    )
    assert [(w.word, w.start, w.end) for w in read(tmp_path, "talk.srt", text)] == [
        ("two", 1.0, pytest.approx(1 + 2 * 3 / 7)),
        ("four", pytest.approx(1 + 2 * 3 / 7), pytest.approx(3.0)),
        ("no", 3600.5, 3601.0),
        ("no", 3601.0, 3602.0),
    ]


def test_vtt_with_word_times_that_rolls_up(tmp_path: Path) -> None:
    text = """WEBVTT
Kind: captions

00:01.000 --> 00:03.000 align:start position:0%
 
so<00:01.500><c> it</c><00:02.000><c> begins</c>

00:03.000 --> 00:03.010 align:start position:0%
so it begins
 

00:03.010 --> 00:05.000 align:start position:0%
so it begins
again<00:04.000><c> and</c>

00:05.000 --> 00:06.000
again and
end
"""  # noqa: W293
    assert read(tmp_path, "talk.en.vtt", text) == [
        Word("so", 1.0, 1.5),
        Word("it", 1.5, 2.0),
        Word("begins", 2.0, 3.0),
        Word("again", 3.01, 4.0),
        Word("and", 4.0, 5.0),
        Word("end", 5.0, 6.0),
    ]


LONG = """File type = "ooTextFile"
Object class = "TextGrid"

xmin = 0
xmax = 2
tiers? <exists>
size = 2
item []:
    item [1]:
        class = "TextTier"
        name = "bells"
        xmin = 0
        xmax = 2
        points: size = 1
        points [1]:
            number = 0.3
            mark = "ding"
    item [2]:
        class = "IntervalTier"
        name = "Ann - words"
        xmin = 0
        xmax = 2
        intervals: size = 3
        intervals [1]:
            xmin = 0
            xmax = 0.5
            text = "sil"
        intervals [2]:
            xmin = 0.5
            xmax = 0.75
            text = "Good"
        intervals [3]:
            xmin = 1.0
            xmax = 1.5
            text = "morning"
"""
SHORT = """File type = "ooTextFile"
Object class = "TextGrid"

0
2
<exists>
2
"IntervalTier"
"phones"
0
2
1
0.5
0.75
"G"
"IntervalTier"
"words"
0
2
2
0.5
0.75
"Good"
1
1.5
"morning"
"""


@pytest.mark.parametrize("text", [LONG, SHORT])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_textgrids_long_and_short(tmp_path: Path, text: str, encoding: str) -> None:
    (tmp_path / "talk.TextGrid").write_text(text, encoding=encoding)
    assert read_transcript(tmp_path / "talk.TextGrid").words == TWO


def test_a_word_that_ends_before_it_starts_has_no_length(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text('[{"word": "back", "start": 2, "end": 1}]')
    assert read_transcript(tmp_path / "a.json").words == [Word("back", 2.0, 2.0)]


def test_ctm(tmp_path: Path) -> None:
    lines = (";; by hand", "talk 1 0.5 0.25 Good 0.98", "talk 1 0.75 0.25 <eps>")
    text = "\n".join([*lines, "talk 1 1.0 0.5 morning\n"])
    assert read(tmp_path, "talk.ctm", text) == TWO


def test_plain_text_is_aligned_and_a_prompt_names_its_samples(tmp_path: Path) -> None:
    sound = np.zeros(48000, np.float32)
    sound[16000:32000] = 0.3 * np.sin(np.arange(16000) * 0.3)
    (tmp_path / "talk.txt").write_text("Go home")
    transcript = read_transcript(tmp_path / "talk.txt")
    assert transcript.words == [] and transcript.text == "Go home"
    # one syllable, then ho-me: two groups of vowels
    words = [(w.word, w.start, w.end) for w in transcript.aligned(sound)]
    third = pytest.approx(1 + 1 / 3, abs=0.002)
    assert words == [("Go", 1.0, third), ("home", third, 2.0)]
    (tmp_path / "talk.txt").write_text("24000 48000 Go home")
    transcript = read_transcript(tmp_path / "talk.txt")
    assert transcript.span == (1.5, 3.0)
    words = [(w.word, w.start, w.end) for w in transcript.aligned(sound)]
    third = pytest.approx(1.5 + 0.5 / 3, abs=0.002)
    assert words == [("Go", 1.5, third), ("home", third, 2.0)]


def test_the_best_transcript_beside_a_video_is_found(tmp_path: Path) -> None:
    video = tmp_path / "talk.one.mp4"
    others = (
        "talk.srt",
        "talk.one.more.srt",
        "talk.one.truth.npz",
        "talk.one.info.json",
        "talk.one.",
    )
    for name in others:
        (tmp_path / name).touch()
    assert find_transcript(video) is None
    for name in ("one.txt", "one.en-US.vtt", "one.textgrid", "one.words.json"):
        (tmp_path / f"talk.{name}").touch()
        found = find_transcript(video)
        assert found is not None and found.name == f"talk.{name}"


@pytest.mark.parametrize(
    ("name", "data", "told"),
    [
        ("a.json", b"{", "cannot be read"),
        ("a.json", b"[]", "holds no words"),
        ("a.json", b'[{"word": "a"}]', "no times for 'a'"),
        ("a.json", b"[1, 2]", "no word with times"),
        ("a.srt", b"hello", "no line such as"),
        ("a.ctm", b"a 1 0.5", "fewer than five"),
        ("a.ctm", b"a 1 x y z", "cannot be read"),
        ("a.TextGrid", b"something", "no TextGrid"),
        ("a.TextGrid", LONG.encode()[:-60], "no TextGrid, or a damaged one"),
        ("a.TextGrid", SHORT[: SHORT.index('"words"')].encode(), "no TextGrid"),
        ("a.txt", b"  ", "holds no words"),
        ("a.txt", b"0 " + b"9" * 400 + b" word", "cannot be read"),
        ("a.json", b'[{"word": "a", "start": 0, "end": NaN}]', "no time for 'a'"),
        ("a.json", b'[{"word": "a", "start": 0, "end": 1' + b"0" * 400 + b"}]", "cannot be read"),
        ("a.ctm", b"a 1 1e999 0.1 word", "no time for 'word'"),
        ("a.srt", b"9" * 400 + b":00:01,0 --> 00:00:02,0\na", "cannot be read"),
        ("a.TextGrid", LONG.replace("xmax = 0.5", "xmax = abc").encode(), "no TextGrid"),
    ],
)
def test_bad_transcripts_are_told_in_one_line(
    tmp_path: Path, name: str, data: bytes, told: str
) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(BadInput, match=told) as error:
        read_transcript(tmp_path / name)
    assert "\n" not in str(error.value) and name in str(error.value)


@pytest.mark.slow
@pytest.mark.skipif(not (SHARED / "transcript").is_dir(), reason="needs the shared data")
def test_every_shared_transcript_is_read() -> None:
    seen = {path.name: read_transcript(path) for path in (SHARED / "transcript").iterdir()}
    counts = {name: len(transcript.words) for name, transcript in seen.items()}
    assert counts == {
        "en_ldc93s1.txt": 0,
        "en_librivox_7s.json": 22,
        "en_librivox_7s.txt": 0,
        "en_manifesto_88s.json": 210,
        "en_manifesto_88s.srt": 206,
        "en_manifesto_88s.vtt": 206,
        "en_sonnet_53s.fragments.json": 107,
        "fr_smartphone_178s.words.json": 555,
        "ted_clip000028_tCAkv4ggPgI.TextGrid": 45,
        "ted_clip000070_lskPN47Lo8o.TextGrid": 39,
    }
    assert len(seen["en_librivox_7s.txt"].text.split()) == 22
    assert seen["en_ldc93s1.txt"].span == (0.0, 46797 / 16000)
    vtt, srt = seen["en_manifesto_88s.vtt"].words, seen["en_manifesto_88s.srt"].words
    assert [w.word for w in vtt] == [w.word for w in srt]
    for transcript in seen.values():
        times = [w.start for w in transcript.words]
        assert times == sorted(times) and all(w.end >= w.start for w in transcript.words)
