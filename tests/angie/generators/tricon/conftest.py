"""Clips with sound and words whose motion follows both, and a model trained on them for seconds."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from angie.generators.stages import StageContext
from angie.generators.tricon.family import tiny
from angie.generators.tricon.generate import TriConGenerator
from angie.generators.tricon.model import TriCon
from angie.generators.tricon.train import train_generator
from angie.motion.clips import MotionClip
from angie.motion.statistics import measure
from data_prep.rates import SAMPLES_PER_FRAME
from data_prep.speech.features import Speech
from data_prep.speech.words import Word
from mraa.motion import Motion
from mraa.training.run import RunConfig

FRAMES = 150


def talk(seed: int, speaker: str) -> MotionClip:
    """Six seconds in which the first of three regions rises at the word "up"."""
    rng = np.random.default_rng(seed)
    at = np.sort(rng.uniform(0.3, 5.3, 3))
    words = [Word(str(rng.choice(["up", "so"])), float(t), float(t) + 0.2) for t in at]
    samples = 0.01 * rng.normal(size=FRAMES * SAMPLES_PER_FRAME)
    time = np.arange(FRAMES) / 25
    shift = np.zeros((FRAMES, 3, 2)) + [[-0.5, 0.0], [0.5, 0.0], [0.0, 0.5]]
    size = 0.3 if speaker == "ada" else 0.1
    for word in words:
        if word.word == "up":
            shift[:, 0, 1] -= size * np.exp(-(((time - word.start - 0.4) / 0.2) ** 2))
    shift += 0.01 * np.sin(2 * time[:, None, None] + np.arange(6).reshape(3, 2))
    cholesky = np.tile([0.1, 0.01, 0.2], (FRAMES, 3, 1)) * (1 + 0.1 * shift[..., :1])
    motion = Motion(*(torch.from_numpy(part.astype(np.float32)) for part in (shift, cholesky)))
    features = {
        "onset": np.zeros((-(-FRAMES // 8), 426), np.float32),
        "mfcc": np.zeros((FRAMES, 28, 12), np.float32),
        "onset_times": np.zeros(0, np.float32),
    }
    speech = Speech(samples.astype(np.float32), words, features=features)
    return MotionClip(f"{speaker}_{seed}", speaker, motion, speech)


@pytest.fixture(scope="session")
def talks() -> list[MotionClip]:
    """Twelve clips of two people."""
    return [talk(seed, "ada" if seed % 2 else "bob") for seed in range(12)]


@pytest.fixture(scope="session")
def settings():
    """Tiny settings for the three regions."""
    base = tiny()
    schedule = replace(base.train.schedule, batch=4, most_steps=8)
    return replace(
        base,
        model=replace(base.model, points=3),
        train=replace(base.train, schedule=schedule, judge_steps=3),
    )


@pytest.fixture(scope="session")
def make_context(talks, settings):
    """The function that makes the context of a training in a folder."""

    def make(folder, changed=None, resume=False, **how) -> StageContext:
        sounds = {clip.name: clip.speech.samples for clip in talks}
        return StageContext(
            "generator", changed or settings, None, measure(talks),
            lambda split: talks if split == "train" else [], sounds.__getitem__, folder, 0,
            RunConfig("cpu", identity="one", **how), resume, folder,
        )  # fmt: skip

    return make


@pytest.fixture(scope="session")
def trained(make_context, tmp_path_factory):
    """What the training stage gives."""
    return train_generator(make_context(tmp_path_factory.mktemp("tricon")))


@pytest.fixture(scope="session")
def generator(trained, settings, talks) -> TriConGenerator:
    """The trained generator."""
    model = TriCon(settings.model, 2)
    model.load_state_dict(trained.tensors)
    return TriConGenerator(model, measure(talks))
