"""How good the shipped bundle is, measured on videos that no training of it has seen."""

import numpy as np
import pytest
import torch

from angie.bundle import BUNDLE, Bundle
from angie.evaluation.space import onsets_within, points
from angie.generators.angie.codes import reconstruction
from angie.generators.angie.family import load_generator
from angie.generators.angie.train import code_windows, stream_entropies
from angie.metrics.beats import consistency, usual_steps
from angie.motion.clips import MotionClip
from angie.motion.windows import MotionWindows
from mraa.draw import regions_of
from mraa.extract import measure_motion
from mraa.renderer import from_pixels, to_pixels

FRAMES = 128


@pytest.fixture(scope="module")
def shipped() -> Bundle:
    return Bundle.open(BUNDLE)


@pytest.fixture(scope="module")
def renderer(shipped):
    return shipped.renderer()


@pytest.fixture(scope="module")
def clips(dataset, renderer) -> list[MotionClip]:
    """The beginnings of three phantom clips, as the shipped region estimator sees them."""
    made = []
    for clip in dataset.clips()[:3]:
        store = dataset.frames(clip)
        frames = np.stack([store[i] for i in range(FRAMES)])
        motion = measure_motion(renderer.estimator, frames, 32)
        made.append(MotionClip(clip.id, clip.speaker, motion, dataset.speech(clip)))
    return made


@torch.no_grad()
def test_the_renderer_draws_other_frames_better_than_the_photo_shows_them(dataset, renderer, clips):
    gains = []
    for clip, moved in zip(dataset.clips()[:3], clips, strict=True):
        store, picks = dataset.frames(clip), [60, 120]
        true = np.stack([store[i] for i in picks]).astype(float)
        photo, cpu = from_pixels(torch.from_numpy(store[0])[None]), torch.device("cpu")
        source = renderer.open(photo, regions_of(renderer, moved.motion[:1], cpu))
        chosen = moved.motion.like(moved.motion.vector()[picks])
        drawn = to_pixels(renderer.draw(source, regions_of(renderer, chosen, cpu))).numpy()
        errors = [((one - true) ** 2).mean() for one in (drawn.astype(float), store[0][None])]
        gains.append(10 * np.log10(errors[1] / errors[0]))
    assert np.mean(gains) > 2.0  # dB


def test_the_codes_give_the_motion_back_and_the_gpt_hears(shipped, clips):
    statistics, generator = shipped.statistics(), load_generator(shipped)
    windows = MotionWindows(clips, statistics, stride=8)
    assert reconstruction(generator.vq, windows)["correlation"] > 0.9
    # of whole clips, as the GPT learnt them; the next clip's sound in place of its own
    coded = code_windows(generator.vq, windows)
    onset = coded.stack("onset", 0, len(coded))
    own = stream_entropies(generator.gpt, coded).sum()
    other = stream_entropies(generator.gpt, coded, onset.roll(len(coded) // 3, 0)).sum()
    assert own < other - 0.4 and own < 11.0  # nats; 12.5 is chance


def test_generated_motion_keeps_time_and_stays_in_range(shipped, clips):
    generator, statistics = load_generator(shipped), shipped.statistics()
    active = statistics.active.numpy()
    made = [generator.generate(c.speech, c.motion[:1], FRAMES, seed=i) for i, c in enumerate(clips)]
    usual = usual_steps([points(c.motion)[:, active] for c in clips])
    sounds = [onsets_within(c, FRAMES) for c in clips]
    moved = [points(m)[:, active] for m in made]
    assert consistency(moved, sounds, usual, 25).value > 0.65
    speed = np.mean([np.abs(np.diff(m, axis=0)).mean() for m in moved])
    real = np.mean([np.abs(np.diff(points(c.motion)[:, active], axis=0)).mean() for c in clips])
    assert 0.3 < speed / real < 1.5
