"""A second family of generators in a folder of two files: nothing else has to know of it.

It works at 15 frames a second, on a feature of its own that hears loudness and words, trains two
networks with two optimisers, and one of its parts is a table of integers.
"""

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import soundfile
import torch
import toy

from angie.bundle import PHOTO, Bundle
from angie.cli import main
from angie.evaluation.evaluate import evaluate
from angie.evaluation.networks import EvaluationConfig
from angie.evaluation.space import open_space
from angie.generators import GENERATORS, family, names
from data_prep.errors import BadInput
from data_prep.media.video import probe
from data_prep.speech.features import Speech
from data_prep.speech.words import Word


@pytest.fixture(scope="module", autouse=True)
def registered():
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(GENERATORS, "toy", lambda: toy.FAMILY)
        yield


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
    """The tiny bundle with the toy trained beside ANGIE, on the command line."""
    folder = tmp_path_factory.mktemp("toy") / "both"
    shutil.copytree(bundle.folder, folder)
    status = command(
        "train", dataset.path, "-o", folder, "--resume", "--generator", "toy", "toy.steps=5"
    )
    assert status == 0
    return Bundle.open(folder)


@pytest.fixture(scope="module")
def clip(both, dataset, tmp_path_factory):
    return open_space(dataset, both, tmp_path_factory.mktemp("motion"), "cpu").test[0]


def test_the_toy_is_small():
    files = sorted(Path(toy.__file__).parent.glob("*.py"))
    lines = [line for file in files for line in file.read_text().splitlines()]
    assert len(files) == 2 and len(lines) < 120


def test_it_lies_beside_angie_in_the_bundle(both, bundle):
    assert both.generators == ["angie", "toy"]
    assert both.settings("toy") == toy.Settings(steps=5)
    assert both.tensors("toy.bins")["edges"].dtype == torch.int32
    for part in bundle.needed():
        assert both.hash_of(part) == bundle.hash_of(part), part
    assert both.report("toy.mover")["windows"] > 0
    assert type(both.generator()) is type(bundle.generator())
    assert isinstance(both.generator("toy"), toy.ToyGenerator)
    with pytest.raises(BadInput, match="--generator robot"):
        both.generator("robot")


def test_it_gestures_at_25_frames_a_second_to_sound_and_words(both, clip):
    generator, start = both.generator("toy"), clip.motion[:1]
    samples = clip.speech.samples[: 3 * 16_000]

    def vector(words=None, **options):
        return generator.generate(Speech(samples, words), start, 70, **options).vector()

    motion = vector(seed=1)
    assert motion.shape == (70, start.vector().shape[1])
    assert torch.allclose(motion[0], start.vector()[0], atol=1e-3)  # but for the least extent
    assert motion.diff(dim=0).abs().amax(1).min() > 0  # no frame of the other rate twice
    assert torch.equal(motion, vector(seed=1)) and not torch.equal(motion, vector(seed=2))
    assert torch.equal(vector(seed=1, greedy=True), vector(seed=2, greedy=True))
    assert not torch.equal(motion, vector([Word("so", 1.0, 1.5)], seed=1))


def test_what_it_streams_is_what_it_generates(both, clip):
    generator, start = both.generator("toy"), clip.motion[:1]
    samples = clip.speech.samples[: 16_000 + 100]
    stream = generator.stream(start, seed=3)
    pieces = [stream.push(samples[first : first + 3000]) for first in range(0, len(samples), 3000)]
    pieces.append(stream.finish())
    made = torch.cat([piece.vector() for piece in pieces])
    assert pieces[1].frames > 0
    whole = generator.generate(Speech(samples), start, 26, seed=3).vector()
    assert len(made) == 26 and torch.allclose(made, whole, atol=1e-6)


def test_it_is_scored_beside_angie_and_alone(both, dataset, tmp_path):
    config = EvaluationConfig(images=False, fgd_steps=2)
    numbers = evaluate(dataset.path, [both.folder], tmp_path / "report", config)
    rows = {row["name"]: row for row in numbers["spaces"][0]["rows"]}
    assert list(rows)[-2:] == ["both (angie)", "both (toy)"]
    assert rows["both (toy)"]["about"].startswith("Toy")
    assert rows["both (toy)"]["scores"]["fgd"]["mean"] > 0
    status = command(
        "evaluate", dataset.path, both.folder, "--generator", "toy", "-o", tmp_path / "alone",
        "--no-images", "--fgd", tmp_path / "report" / "fgd-0.safetensors",
    )  # fmt: skip
    table = (tmp_path / "alone" / "table.csv").read_text()
    assert status == 0 and ",both," in table and "angie" not in table


@pytest.mark.usefixtures("one_process")
def test_the_command_takes_it_by_its_name(both, tmp_path, monkeypatch):
    lengths, generate = [], toy.ToyGenerator.generate_own

    def counted(self, speech, start, frames, **options):
        lengths.append(frames)
        return generate(self, speech, start, frames, **options)

    monkeypatch.setattr(toy.ToyGenerator, "generate_own", counted)
    soundfile.write(tmp_path / "speech.wav", np.sin(np.arange(16_000) / 9), 16_000)
    video = tmp_path / "video.mp4"
    words = ["animate", PHOTO, tmp_path / "speech.wav", "--speaker", both.folder, "-o", video]
    assert command(*words, "--generator", "robot") == 2 and not video.exists()
    assert command(*words, "--generator", "toy") == 0
    assert lengths == [16] and probe(video).duration == pytest.approx(1, abs=0.05)


def test_a_package_brings_its_family_by_an_entry_point(tmp_path, monkeypatch):
    monkeypatch.delitem(GENERATORS, "toy")
    with pytest.raises(BadInput, match="choose from angie"):
        family("toy")
    place = tmp_path / "toy_gestures-1.0.dist-info"
    place.mkdir()
    (place / "METADATA").write_text("Metadata-Version: 2.1\nName: toy-gestures\nVersion: 1.0\n")
    (place / "entry_points.txt").write_text(
        "[angie.generators]\ntoy = toy:FAMILY\ntorn = toy:NOTHING\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    assert family("toy") is toy.FAMILY and names()[-2:] == ["torn", "toy"]
    with pytest.raises(BadInput, match="torn: toy:NOTHING cannot be loaded"):
        family("torn")
