"""Training of the co-speech GPT on the codes of a frozen VQ motion extractor."""

from dataclasses import dataclass, field
from pathlib import Path

import torch

from angie.gpt import CoSpeechGPT, GPTConfig
from angie.schedule import BestWeights, Schedule
from angie.train_vq import encode_windows
from angie.vq import VQMotionExtractor
from angie.windows import MotionWindows
from mraa.run import Run, RunConfig


@dataclass(frozen=True)
class GPTTraining:
    """Training of the co-speech GPT; the defaults are the paper's, where it gives any.

    Attributes:
        schedule: Adam 3e-4, batch 32, up to 500 epochs, milestones 250 and 400.
        checks: evenly spaced evaluations on the held-out windows.
        patience: evaluations without improvement after which training stops.
    """

    schedule: Schedule = field(default_factory=lambda: Schedule(rate=3e-4, milestones=(250, 400)))
    checks: int = 100
    patience: int = 20

    def __post_init__(self) -> None:
        if min(self.checks, self.patience) < 1:
            raise ValueError("checks and patience must be positive")


def train_gpt(
    folder: Path,
    vq: VQMotionExtractor,
    windows: MotionWindows,
    held_out: MotionWindows | None,
    config: GPTConfig,
    training: GPTTraining,
    *,
    seed: int = 0,
    run_config: RunConfig | None = None,
    resume: bool = False,
) -> CoSpeechGPT:
    """Train the GPT to predict codes 2 to 12 of each window from those before and the sound.

    Loss: cross-entropy of both streams, added. With held-out windows the weights with the lowest
    held-out cross-entropy are the result, and training stops when they no longer improve.

    Args:
        folder: where checkpoint and curves go.
        vq: the trained extractor, frozen.
        windows: training windows.
        held_out: windows of clips that are not in `windows`, or None.
        config: architecture.
        training: how to train.
        seed: everything random follows from it.
        run_config: device, precision and so on.
        resume: go on from the checkpoint in `folder`.

    Returns:
        The trained GPT in evaluation mode.
    """
    schedule, items = training.schedule, len(windows)
    steps = schedule.steps(items)
    every = max(1, steps // training.checks)
    run = Run(folder, "gpt", steps=steps, seed=seed, config=run_config, resume=resume)
    vq = vq.to(run.device)
    windows = code_windows(vq, windows)
    held_out = None if held_out is None else code_windows(vq, held_out)
    gpt = CoSpeechGPT(config)
    best = BestWeights(gpt)
    model, optimizer = run.setup(best, schedule.adam(gpt))
    batches = run.batches(windows, schedule.batch)
    model.train()
    for step in run.steps():
        if int(best.age) >= training.patience:
            run.save()
            break
        run.rate(optimizer, schedule.rate, schedule.milestone_steps(items))
        batch = next(batches)
        codes, onset = batch["codes"], batch["onset"]
        loss = gpt.loss(model(codes[..., :-1], onset[:, 1:]), codes[..., 1:])
        run.backward(loss)
        run.clip(model, optimizer, schedule.clip)
        optimizer.step()
        optimizer.zero_grad()
        if held_out is not None and (step + 1) % every == 0:
            best.consider(run.fabric.broadcast(cross_entropy(gpt, held_out)))
        run.log(loss=loss, **best.scores())
    best.restore()
    return gpt.eval().cpu()


def code_windows(vq: VQMotionExtractor, windows: MotionWindows) -> MotionWindows:
    """Windows with `onset` (12, 426) and their `codes` (2, 12)."""
    return windows.choose(["onset"], codes=encode_windows(vq, windows))


@torch.no_grad()
def cross_entropy(gpt: CoSpeechGPT, windows: MotionWindows, at_once: int = 64) -> float:
    """Mean cross-entropy, both streams added, of windows with `onset` and `codes`, in nats."""
    device, training = gpt.positions.device, gpt.training
    gpt.eval()
    total = 0.0
    for first in range(0, len(windows), at_once):
        onset = windows.stack("onset", first, first + at_once).to(device)
        codes = windows.stack("codes", first, first + at_once).to(device)
        loss = gpt.loss(gpt(codes[..., :-1], onset[:, 1:]), codes[..., 1:])
        total += float(loss) * len(codes)
    gpt.train(training)
    return total / len(windows)
