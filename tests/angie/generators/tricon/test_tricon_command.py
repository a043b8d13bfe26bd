"""TriCon on the command line: trained beside ANGIE, asked with words and styles, scored."""

import json
import shutil
import sys

import numpy as np
import pytest
from PIL import Image

from angie.bundle import PHOTO, Bundle
from angie.cli import main
from angie.evaluation.evaluate import evaluate
from angie.evaluation.networks import EvaluationConfig
from angie.style import styles
from data_prep.media.audio import write_wav
from data_prep.media.video import probe
from data_prep.phantom.make import recording

TRAINING = (
    "tricon.train.schedule.most_steps=4", "tricon.train.schedule.batch=4",
    "tricon.train.judge_steps=2",
)  # fmt: skip


def command(*words) -> int:
    """Exit status of `angie WORDS`."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["angie", *map(str, words)])
        try:
            main()
        except SystemExit as leave:
            return leave.code or 0
    return 0


@pytest.fixture(scope="module")
def both(bundle, dataset, tmp_path_factory) -> Bundle:
    """The tiny bundle with TriCon trained beside ANGIE."""
    folder = tmp_path_factory.mktemp("tricon") / "both"
    shutil.copytree(bundle.folder, folder)
    line = ["train", dataset.path, "-o", folder, "--resume", "--generator", "tricon", *TRAINING]
    assert command(*line) == 0
    return Bundle.open(folder)


@pytest.fixture(scope="module")
def talk(tmp_path_factory):
    """A second of speech and its words, in several formats."""
    folder = tmp_path_factory.mktemp("talk")
    speech = recording(0, seconds=3.0, seed=5)
    write_wav(folder / "speech.wav", speech.samples[: speech.rate], speech.rate)
    words = [{"word": "big", "start": 0.2, "end": 0.5}, {"word": "idea", "start": 0.5, "end": 0.9}]
    (folder / "words.json").write_text(json.dumps(words))
    (folder / "same.srt").write_text("1\n00:00:00,200 --> 00:00:00,900\nbig idea\n")
    (folder / "plain.txt").write_text("a big idea")
    (folder / "none.json").write_text("[]")
    return folder


def gestured(both, talk, place, *options):
    """Region centres (T, K, 2) of `angie gestures`."""
    place.unlink(missing_ok=True)
    line = ["gestures", both.folder, talk / "speech.wav", "-o", place, "--generator", "tricon"]
    assert command(*line, *options) == 0
    with np.load(place) as file:
        return file["shift"]


def test_it_lies_beside_angie(both, bundle, capsys):
    assert both.generators == ["angie", "tricon"]
    assert both.hash_of("angie.gpt") == bundle.hash_of("angie.gpt")
    assert command("info", both.folder) == 0
    text = capsys.readouterr().out
    assert f"styles      {', '.join(styles(both, 'tricon'))} (--style NAME)" in text
    assert "million weights" in text


def test_a_video_to_words(both, talk, tmp_path, capsys):
    line = [
        "animate",
        PHOTO,
        talk / "speech.wav",
        "--speaker",
        both.folder,
        "--generator",
        "tricon",
    ]
    assert command(*line, "-o", tmp_path / "with.mp4", "--words", talk / "words.json") == 0
    assert "without words" not in "".join(capsys.readouterr())
    assert probe(tmp_path / "with.mp4").duration == pytest.approx(1, abs=0.05)
    assert command(*line, "-o", tmp_path / "without.mp4") == 0
    heard = "".join(capsys.readouterr())
    assert heard.count("gestures without words; --words FILE gives a transcript") == 1


def test_words_of_every_format_are_read(both, talk, tmp_path):
    place = tmp_path / "made.npz"
    made = [gestured(both, talk, place)] + [
        gestured(both, talk, place, "--words", talk / name)
        for name in ("words.json", "same.srt", "plain.txt")
    ]
    assert made[0].shape == (25, 10, 2)
    for other in made[1:]:
        assert np.array_equal(made[0][0], other[0]) and not np.array_equal(made[0], other)


def test_styles_are_named_mixed_and_pointed_at(both, talk, tmp_path):
    place, (first, second) = tmp_path / "made.npz", styles(both, "tricon")
    point = ",".join(["0.5", "-1", "0", "0", "0", "0", "0", "2"])
    made = [
        gestured(both, talk, place, f"--style={style}")
        for style in (first, second, f"{first}:0.3,{second}:0.7", point)
    ]
    assert len({one.tobytes() for one in made}) == 4


@pytest.mark.parametrize(
    ("options", "text"),
    [(["--words", "none.json"], "none.json: holds no words"),
     (["--words", "nowhere.srt"], "nowhere.srt"), (["--style", "nobody"], "nobody"),
     (["--style", "1,2,3"], "8 numbers"), (["--words", "speech.wav"], "speech.wav")],
)  # fmt: skip
def test_what_cannot_be_used_is_one_line(both, talk, tmp_path, monkeypatch, capsys, options, text):
    monkeypatch.chdir(talk)
    output = tmp_path / "out.mp4"
    line = ["animate", PHOTO, "speech.wav", "--speaker", both.folder, "--generator", "tricon"]
    assert command(*line, "-o", output, *options) == 2
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1 and text in captured.err and captured.out == ""
    assert not output.exists()


def test_words_for_a_generator_that_does_not_read_them(bundle, talk, tmp_path, capsys):
    line = ["gestures", bundle.folder, talk / "speech.wav", "-o", tmp_path / "made.npz"]
    assert command(*line, "--words", talk / "words.json") == 0
    assert "the words are not used" in "".join(capsys.readouterr())


def test_it_is_scored_beside_angie_with_its_rate_and_styles(both, dataset, tmp_path):
    config = EvaluationConfig(images=False, fgd_steps=2)
    numbers = evaluate(dataset.path, [both.folder], tmp_path / "report", config)
    space = numbers["spaces"][0]
    rows = {row["name"]: row for row in space["rows"]}
    assert list(rows)[-3:] == ["truth at 15 fps", "both (angie)", "both (tricon)"]
    assert (
        rows["truth at 15 fps"]["scores"]["fgd"]["mean"]
        < rows["motionless"]["scores"]["fgd"]["mean"]
    )
    (drawn,) = space["styles"]
    assert drawn["row"] == "both (tricon)" and set(drawn["points"]) == set(styles(both, "tricon"))
    page = (tmp_path / "report" / "report.html").read_text()
    assert "Styles of both (tricon)" in page


def test_photos_may_be_pictures(both, talk, tmp_path):
    from angie.pipeline import GesturePipeline
    from data_prep.speech.words import Word

    pipe = GesturePipeline(both, "tricon")
    said = [Word("big", 0.2, 0.5)]
    video = pipe(Image.open(PHOTO), talk / "speech.wav", words=said, style="1,0,0,0,0,0,0,0")
    assert video.frames == 25 and "words" not in video.note
