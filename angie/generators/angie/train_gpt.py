"""Training of the co-speech GPT on the codes of a frozen VQ motion extractor."""

from dataclasses import dataclass, field
from pathlib import Path

import torch
from torch import Tensor

from angie.generators.angie.codes import window_codes
from angie.generators.angie.gpt import CoSpeechGPT, GPTConfig
from angie.generators.angie.tokenizer import VQMotionExtractor
from angie.motion.windows import STRIDE, MotionWindows, check_stride
from data_prep.rates import FRAMES_PER_TOKEN
from mraa.training.checkpoint import BestWeights, Schedule
from mraa.training.run import Run, RunConfig


@dataclass(frozen=True)
class GPTTraining:
    """Training of the co-speech GPT; the defaults are the paper's, where it gives any.

    Attributes:
        schedule: Adam 3e-4, batch 32, up to 500 epochs, milestones 250 and 400.
        checks: evenly spaced evaluations on the held-out windows.
        patience: evaluations without improvement after which training stops.
        stride: frames from one training window to the next, a multiple of 8
            (Bailando's GPT takes 8).
        grids: grids of tokens on which codes and onset features of the training clips are read:
            1, from the first frame on; with 2, 4 or 8 each clip is learnt that many times, begun
            8 / grids frames later each time. Without `most_steps` training takes as many times
            longer. Not in the papers.
    """

    schedule: Schedule = field(default_factory=lambda: Schedule(rate=3e-4, milestones=(250, 400)))
    checks: int = 100
    patience: int = 20
    stride: int = STRIDE
    grids: int = 1

    def __post_init__(self) -> None:
        if min(self.checks, self.patience) < 1:
            raise ValueError("checks and patience must be positive")
        if self.grids < 1 or FRAMES_PER_TOKEN % self.grids:
            raise ValueError(f"grids must be 1, 2, 4 or 8, not {self.grids}")
        check_stride(self.stride, FRAMES_PER_TOKEN)


ANYONE = 0.1
"""Share of the windows in which a joint model is not told who speaks."""


def someone(speaker: Tensor, speakers: int) -> Tensor:
    """Places (B,) of speakers, some at random replaced by anyone's, `speakers`."""
    hidden = torch.rand(speaker.shape, device=speaker.device) < ANYONE
    return torch.where(hidden, speakers, speaker)


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
    speakers = len(windows.statistics.speakers)
    gpt = CoSpeechGPT(config, speakers)
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
        who = someone(batch["speaker"], speakers) if config.joint else None
        loss = gpt.loss(model(codes[..., :-1], onset[:, 1:], who), codes[..., 1:])
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
    """Windows with `onset` (12, 426), `speaker` and their `codes` (streams, 12)."""
    return windows.choose(["onset", "speaker"], codes=window_codes(vq, windows))


def cross_entropy(gpt: CoSpeechGPT, windows: MotionWindows) -> float:
    """Mean cross-entropy, all streams added, of windows with `onset` and `codes`, in nats."""
    return float(stream_entropies(gpt, windows).sum())


@torch.no_grad()
def stream_entropies(
    gpt: CoSpeechGPT, windows: MotionWindows, onset: Tensor | None = None, at_once: int = 64
) -> Tensor:
    """Mean cross-entropy (streams,) of the codes 2 to 12 of windows, in nats per code.

    Args:
        gpt: of any mode, which it keeps.
        windows: with `onset`, `speaker` and `codes`.
        onset: (n, 12, 426) other sound in place of the windows' own.
        at_once: windows computed together.
    """
    device, training = gpt.positions.device, gpt.training
    gpt.eval()
    total = torch.zeros(gpt.config.streams, dtype=torch.float64)
    for first in range(0, len(windows), at_once):
        last = min(first + at_once, len(windows))
        sound = windows.stack("onset", first, last) if onset is None else onset[first:last]
        codes = windows.stack("codes", first, last).to(device)
        who = windows.stack("speaker", first, last).to(device) if gpt.config.joint else None
        logits = gpt(codes[..., :-1], sound[:, 1:].to(device), who)
        for stream in range(len(total)):
            loss = gpt.loss(logits[:, stream : stream + 1], codes[:, stream : stream + 1, 1:])
            total[stream] += float(loss) * len(codes)
    gpt.train(training)
    return total / len(windows)
