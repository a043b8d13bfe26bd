"""Small synthetic clips whose motion follows their sound, and a bundle that is joint."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

from angie.bundle import PHOTO, SPEECH, Bundle
from angie.config import override
from angie.generators.angie.family import load_gpt
from angie.generators.angie.gpt import CoSpeechGPT
from angie.motion.clips import MotionClip
from angie.motion.statistics import MotionStatistics, measure
from angie.pipeline import GesturePipeline
from data_prep.media.audio import read_sound, write_wav
from data_prep.speech.features import Speech
from mraa.motion import Motion

REGIONS = 4


def envelope(frames: int, rng: np.random.Generator) -> np.ndarray:
    """Phrases: bursts of 24 frames that are either loud or silent, smooth at their ends."""
    loud = rng.integers(0, 2, frames // 24 + 2).repeat(24)[:frames].astype(np.float64)
    return np.convolve(np.pad(loud, 4, mode="edge"), np.hanning(9) / 4, mode="valid")


def speech_of(level: np.ndarray, rng: np.random.Generator) -> Speech:
    frames = len(level)
    tokens = -(-frames // 8)
    onset = rng.normal(size=(tokens, 426)).astype(np.float32) * 0.1
    padded = np.pad(level, (0, tokens * 8 - frames), mode="edge")
    onset[:, :40] += padded.reshape(tokens, 8).mean(1, keepdims=True).astype(np.float32) * 10
    onset[:, 41] = rng.integers(0, 2, tokens)
    mfcc = rng.normal(size=(frames, 28, 12)).astype(np.float32) * 0.1
    mfcc += level[:, None, None].astype(np.float32)
    features = {"onset": onset, "mfcc": mfcc, "onset_times": np.zeros(0, np.float32)}
    return Speech.of_features(features, frames)


def synthetic_clip(frames: int, seed: int, speaker: str = "ada") -> MotionClip:
    """A clip in which two regions swing while there is sound and rest while there is none."""
    rng = np.random.default_rng(seed)
    level = envelope(frames, rng)  # (T,)
    swing = 0.2 * level * np.sin(np.arange(frames) * 2 * np.pi / 24)
    shift = np.zeros((frames, REGIONS, 2))
    shift[:] = [[-0.5, 0.5], [0.5, 0.5], [0.0, -0.5], [0.0, 0.0]]
    shift[:, 0, 1] += swing
    shift[:, 1, 1] -= swing
    cholesky = np.zeros((frames, REGIONS, 3))
    cholesky[:] = [0.15, 0.02, 0.1]
    cholesky[:, :2, 1] += 0.2 * swing[:, None]
    shift += rng.normal(size=shift.shape) * 1e-4
    cholesky += rng.normal(size=cholesky.shape) * 1e-4
    motion = Motion(
        torch.from_numpy(shift.astype(np.float32)), torch.from_numpy(cholesky.astype(np.float32))
    )
    return MotionClip(f"{speaker}_{seed}", speaker, motion, speech_of(level, rng))


@pytest.fixture(scope="session")
def make_clip():
    """The function that makes a synthetic clip of (frames, seed, speaker)."""
    return synthetic_clip


@pytest.fixture(scope="session")
def clips(make_clip) -> list[MotionClip]:
    """Twelve clips of ten seconds by two speakers."""
    return [make_clip(250, seed, "ada" if seed % 2 else "bob") for seed in range(12)]


@pytest.fixture(scope="session")
def statistics(clips) -> MotionStatistics:
    """The statistics of `clips`."""
    return measure(clips)


@pytest.fixture(scope="session")
def joint_bundle(bundle, tmp_path_factory) -> Bundle:
    """The tiny bundle made joint: the trained GPT with strong random embeddings of its speakers."""
    folder = tmp_path_factory.mktemp("joint") / "bundle"
    shutil.copytree(bundle.folder, folder, ignore=shutil.ignore_patterns("train"))
    made = Bundle.open(folder)
    made.preset = override(made.preset, {"gpt": {"joint": True}})
    torch.manual_seed(0)
    gpt = CoSpeechGPT(made.settings("angie").gpt, len(made.statistics().speakers))
    torch.nn.init.normal_(gpt.speaker.weight, std=2.0)
    gpt.load_state_dict({**gpt.state_dict(), **load_gpt(bundle).state_dict()})
    made.add("angie.gpt", gpt.state_dict(), {})
    return made


@pytest.fixture
def one_process(monkeypatch):
    """Sound is read when it is asked for: what is refused before needs no process for it."""
    monkeypatch.setattr("angie.commands.animate.begin", lambda work, task: lambda: work(task))


@pytest.fixture(scope="session")
def shipped() -> GesturePipeline:
    """The pipeline of the bundle that ships."""
    return GesturePipeline.from_pretrained()


@pytest.fixture(scope="session")
def blip(tmp_path_factory) -> Path:
    """Eight tenths of a second of the speech that ships: 20 frames."""
    path = tmp_path_factory.mktemp("blip") / "blip.wav"
    write_wav(path, read_sound(SPEECH)[16_000:28_800], 16_000)
    return path


@pytest.fixture(scope="session")
def short_video(shipped, blip):
    """A video of the photo that ships, and of `blip`; not drawn yet."""
    return shipped(PHOTO, blip, seed=3)
