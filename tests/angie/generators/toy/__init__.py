"""A toy family: gestures that follow loudness and words, at 15 frames a second."""

from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from torch.nn.functional import softplus

from angie.generators.base import Family, ResamplingGenerator, resample
from angie.generators.stages import Stage, Trained
from data_prep.rates import FPS, SAMPLE_RATE, frames_covering
from data_prep.speech.features import Speech
from mraa.motion import positive

from .model import BINS, NOISE, RATE, Mover


@dataclass(frozen=True)
class Settings:
    width: int = 8
    steps: int = 10


class ToyGenerator(ResamplingGenerator):
    fps, features, lookahead, random = RATE, ("toy_sound",), 1 / RATE, True

    def __init__(self, parts, precision):
        self.edges, self.scale = parts.tensors("toy.bins")["edges"], parts.statistics().pose_scale
        self.mover = parts.load("toy.mover", Mover(parts.settings("toy").width, len(self.scale)))

    @torch.no_grad()
    def generate_own(self, speech, start, frames, *, seed=0, greedy=None, **others):
        rows = torch.from_numpy(speech["toy_sound"].take(range(frames), axis=0, mode="clip"))
        noise = torch.randn(1, NOISE, generator=torch.Generator().manual_seed(seed))
        moved = self.mover(rows[None], self.edges, 0 * noise if greedy else noise)[0]
        return positive(start.like(start.vector() + (moved - moved[:1]) * self.scale))

    def stream(self, start, **options):
        return ToyStream(partial(self.generate, start=start, **options))


class ToyStream:
    def __init__(self, generate):
        self.generate, self.samples, self.given = generate, np.zeros(0, np.float32), 0

    def push(self, samples, whole=False):  # all anew each time: it is a toy
        self.samples = np.concatenate([self.samples, samples])
        own = len(self.samples) * RATE // SAMPLE_RATE  # frames that will not change any more
        frames = frames_covering(len(self.samples)) if whole else (own - 1) * FPS // RATE + 1
        first, self.given = self.given, frames
        return self.generate(Speech(self.samples), frames=frames)[first:]

    def finish(self):
        return self.push(self.samples[:0], whole=True)


def fit_bins(context):
    rows = np.concatenate([clip.speech["toy_sound"] for clip in context.clips()[0]])
    edges = np.quantile(1000 * rows[:, 0], np.arange(1, BINS) / BINS).round().astype(np.int32)
    return Trained({"edges": torch.from_numpy(edges)})


def train_mover(context):
    edges, statistics = context.bundle.tensors("toy.bins")["edges"], context.statistics
    items = []
    for clip in context.clips()[0]:
        moved = clip.motion.vector() - statistics.rest_of(clip.speaker)
        moved = resample(clip.motion.like(moved / statistics.pose_scale), FPS, RATE).vector()
        rows = torch.from_numpy(clip.speech["toy_sound"][: len(moved)])
        items += zip(rows.split(30)[:-1], moved.split(30)[:-1], strict=True)
    size, run = moved.shape[1], context.begin(context.settings.steps)
    mover, critic = Mover(context.settings.width, size), torch.nn.Linear(size, 1)
    move = run.add("mover", mover, torch.optim.Adam(mover.parameters(), 1e-2))
    judge = run.add("critic", critic, torch.optim.Adam(critic.parameters(), 1e-2))
    batches = run.batches(items, 4)
    for _ in run.steps():
        rows, real = next(batches)
        made = move(rows, edges, torch.randn(len(rows), NOISE))
        run.update((softplus(judge(made.detach())) + softplus(-judge(real))).mean(), "critic")
        run.update((made - real).abs().mean() + 0.1 * softplus(-judge(made)).mean(), "mover")
    return Trained(mover.state_dict(), {"windows": len(items)})


BINS_STAGE = Stage("bins", ("statistics",), fit_bins)
MOVER_STAGE = Stage("mover", ("statistics", "bins"), train_mover, lambda s: {"width": s.width})
FAMILY = Family("toy", "Toy", Settings, (BINS_STAGE, MOVER_STAGE), ToyGenerator)
