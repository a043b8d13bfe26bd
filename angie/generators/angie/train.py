"""Training of ANGIE's parts: the VQ motion extractor, the co-speech GPT, and motion without codes.

Each is a loss and a score; steps, checkpoints and the choice of the best weights are `Run`'s.

What trains takes `begin`, which begins the run of so many steps, training windows, windows of
other clips to choose the weights by (or None), the architecture and how to train, and returns the
trained network on the CPU in evaluation mode. Extractors that are given are trained, and frozen.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Protocol

import torch
from torch import Tensor, nn

from angie.generators.angie.channels import Channels
from angie.generators.angie.codes import (
    STREAMS,
    evaluating,
    mean_for_activity,
    patterns,
    reconstruction,
    window_codes,
)
from angie.generators.angie.gpt import CoSpeechGPT, GPTConfig
from angie.generators.angie.tokenizer import DirectMotion, VQConfig, VQMotionExtractor
from angie.motion.windows import STRIDE, MotionWindows, check_stride
from data_prep.rates import FRAMES_PER_TOKEN
from mraa.training.checkpoint import Schedule
from mraa.training.run import Run

Begin = Callable[[int], Run]
"""Begins the run of a stage of so many steps; see `angie.generators.stages.StageContext.begin`."""

NORMS: dict[str, Callable[[Tensor], Tensor]] = {"absolute": Tensor.abs, "square": Tensor.square}

CLUSTERED = 1000
"""Windows of which codebooks are begun after a warm-up, at most."""


@dataclass(frozen=True)
class VQTraining:
    """Training of the VQ motion extractor; the defaults are the paper's.

    Attributes:
        schedule: Adam 3e-5, batch 32, 500 epochs.
        commitment: weight of the commitment loss (b1 and b2 of equation 9).
        latent: weight of the codebook loss, which is zero under EMA.
        stride: frames from one training window to the next. One that is no multiple of 8, a
            code's frames, shows every movement at other phases of the codes; not in the paper.
        checks: evenly spaced evaluations on the held-out windows, for the curves.
        path_loss: weight of the mean absolute error of the deltas summed up from the window's
            beginning, which holds patterns near the true path; not in the paper. Channels count
            as they move in the picture: by their scale over the mean scale of their stream.
        path_loss_norm: "absolute" or "square" of that error; the square, in which wide gestures
            count more, is what the correlation of paths asks for.
        warmup: part of the steps before the codebooks come in; these then begin with the cluster
            centres of the encoders' vectors, not with vectors of one batch. Not in the paper.
    """

    schedule: Schedule = field(default_factory=lambda: Schedule(rate=3e-5))
    commitment: float = 0.1
    latent: float = 1.0
    stride: int = STRIDE
    checks: int = 50
    path_loss: float = 0.0
    path_loss_norm: str = "absolute"
    warmup: float = 0.0

    def __post_init__(self) -> None:
        if self.path_loss_norm not in NORMS:
            raise ValueError(
                f"path_loss_norm is one of {', '.join(NORMS)}, not {self.path_loss_norm!r}"
            )
        if self.checks < 1 or self.path_loss < 0:
            raise ValueError("checks must be positive, path_loss not negative")
        if min(self.commitment, self.latent) < 0:
            raise ValueError("commitment and latent must not be negative")
        if not 0 <= self.warmup < 1:
            raise ValueError("warmup is a part of the steps, below 1")
        check_stride(self.stride)


def train_vq(
    begin: Begin,
    windows: MotionWindows,
    held_out: MotionWindows | None,
    config: VQConfig,
    training: VQTraining,
) -> VQMotionExtractor:
    """Train the VQ motion extractor (ANGIE, equation 9).

    Loss: mean absolute error of the deltas, shift and Cholesky stream each, and the commitment
    (under `update="loss"` also the codebook's) mean squared error. Reconstruction and use of the
    codes are watched on held-out windows; at the end the extractor's `mean` is measured.
    """
    windows = windows.choose(["poses"])
    schedule, items = training.schedule, len(windows)
    steps = schedule.steps(items)
    run = begin(steps)
    vq = VQMotionExtractor(config)
    model = run.add("vq", vq, schedule.adam(vq), schedule.milestone_steps(items))
    batches = run.batches(windows, schedule.batch)
    channels = Channels.of(windows.statistics, config.quant).to(run.device)
    weights = torch.cat([part / part.mean() for part in channels.scale.split(config.channels)])
    warmup = int(training.warmup * steps)
    for step in run.steps():
        target = channels.normalise(next(batches)["poses"])
        if step == warmup > 0:
            spread = torch.linspace(0, items - 1, min(items, CLUSTERED)).long().tolist()
            some = windows.chosen(spread).stack("poses", 0, len(spread))
            vq.init_codebook(channels.normalise(some.to(run.device)))
        result = model(target, step >= warmup)
        errors = stream_errors(result.deltas.float(), target, config)
        loss = torch.stack(list(errors.values())).sum()
        loss = loss + training.commitment * result.commitment + training.latent * result.latent
        if training.path_loss and bool(channels.relative.any()):
            off = (result.deltas.float() - target) * weights
            path = off[..., channels.relative].cumsum(dim=1)
            errors["path"] = NORMS[training.path_loss_norm](path).mean()
            loss = loss + training.path_loss * errors["path"]
        run.update(loss, "vq", clip=schedule.clip)
        use = {}
        for name, stream in zip(STREAMS, vq.streams, strict=False):
            use[f"{name}_perplexity"] = stream.codebook.perplexity()
            use[f"{name}_used"] = stream.codebook.used()
        if held_out is not None and run.due(training.checks) and run.fabric.global_rank == 0:
            scores = reconstruction(vq, held_out)
            run.curves.add(step, {f"held_out_{name}": value for name, value in scores.items()})
        run.log(loss=loss, **errors, commitment=result.commitment, **use)
    vq.eval()
    vq.mean.copy_(mean_for_activity(patterns(vq, windows).split(64)))
    return vq.cpu()


def stream_errors(made: Tensor, target: Tensor, config: VQConfig) -> dict[str, Tensor]:
    """Mean absolute error of each stream of (B, T, 5K), by its name."""
    parts = (made - target).abs().split(config.channels, dim=-1)
    return {name: part.mean() for name, part in zip(STREAMS, parts, strict=False)}


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


SPEAKER_DROPOUT = 0.1
"""Share of the windows in which a joint model is not told who speaks."""


def speaker_dropout(speaker: Tensor, speakers: int) -> Tensor:
    """Places (B,) of speakers, some at random replaced by anyone's, `speakers`."""
    hidden = torch.rand(speaker.shape, device=speaker.device) < SPEAKER_DROPOUT
    return torch.where(hidden, speakers, speaker)


def train_gpt(
    begin: Begin,
    vq: VQMotionExtractor,
    windows: MotionWindows,
    held_out: MotionWindows | None,
    config: GPTConfig,
    training: GPTTraining,
) -> CoSpeechGPT:
    """Train the GPT to predict codes 2 to 12 of each window from those before and the sound.

    Loss: cross-entropy of both streams, added. With held-out windows the weights with the lowest
    held-out cross-entropy are the result, and training stops when they no longer improve.
    """
    run = begin(training.schedule.steps(len(windows)))
    vq = vq.to(run.device)
    windows = code_windows(vq, windows)
    speakers = len(windows.statistics.speakers)
    gpt = CoSpeechGPT(config, speakers)

    def losses(model: nn.Module, batch: dict[str, Tensor]) -> dict[str, Tensor]:
        codes, onset = batch["codes"], batch["onset"]
        who = speaker_dropout(batch["speaker"], speakers) if config.joint else None
        return {"loss": gpt.loss(model(codes[..., :-1], onset[:, 1:], who), codes[..., 1:])}

    score = None if held_out is None else partial(cross_entropy, gpt, code_windows(vq, held_out))
    fit(run, "gpt", gpt, windows, training, losses, score, training.patience)
    return gpt.cpu()


class Training(Protocol):
    """What `fit` has to know of how to train."""

    @property
    def schedule(self) -> Schedule:
        """Rate, batch and steps."""

    @property
    def checks(self) -> int:
        """Evaluations."""


def fit(
    run: Run,
    name: str,
    model: nn.Module,
    windows: MotionWindows,
    training: Training,
    losses: Callable[[nn.Module, dict[str, Tensor]], dict[str, Tensor]],
    score: Callable[[], float] | None,
    patience: int = 0,
) -> None:
    """Minimise the sum of the losses of batches; with a score, keep the weights with the lowest.

    `model`: to be trained; in evaluation mode afterwards. `losses`: of a batch by their names,
    given the model as the run wraps it. `score`: of the model on other windows; None without any.
    `patience`: evaluations without improvement after which training stops; 0 for never.
    """
    schedule, items = training.schedule, len(windows)
    wrapped = run.add(name, model, schedule.adam(model), schedule.milestone_steps(items))
    batches = run.batches(windows, schedule.batch)
    for _ in run.steps():
        parts = losses(wrapped, next(batches))
        loss = torch.stack(list(parts.values())).sum()
        run.update(loss, name, clip=schedule.clip)
        if score is not None and run.due(training.checks):
            run.keep_best(score(), patience)
        run.log(**{**parts, "loss": loss})
    run.restore_best()
    model.eval()


def code_windows(vq: VQMotionExtractor, windows: MotionWindows) -> MotionWindows:
    """Windows with `onset` (12, 426), `speaker` and their `codes` (streams, 12)."""
    return windows.choose(["onset", "speaker"], codes=window_codes(vq, windows))


def cross_entropy(gpt: CoSpeechGPT, windows: MotionWindows) -> float:
    """Mean cross-entropy, all streams added, of windows with `onset` and `codes`, in nats."""
    return float(stream_entropies(gpt, windows).sum())


def stream_entropies(
    gpt: CoSpeechGPT, windows: MotionWindows, onset: Tensor | None = None
) -> Tensor:
    """Mean cross-entropy (streams,) of the codes 2 to 12 of windows, in nats per code.

    Args:
        gpt: of any mode, which it keeps.
        windows: with `onset`, `speaker` and `codes`.
        onset: (n, 12, 426) other sound in place of the windows' own.
    """
    if onset is not None:
        windows = windows.choose(["speaker"], codes=windows.rows["codes"], onset=onset)
    device = gpt.positions.device
    total = torch.zeros(gpt.config.streams, dtype=torch.float64)
    with evaluating(gpt):
        for group in windows.groups("onset", "codes", "speaker"):
            sound, codes, who = (part.to(device) for part in group.values())
            logits = gpt(codes[..., :-1], sound[:, 1:], who if gpt.config.joint else None)
            for stream in range(len(total)):
                loss = gpt.loss(logits[:, stream : stream + 1], codes[:, stream : stream + 1, 1:])
                total[stream] += float(loss) * len(codes)
    return total / len(windows)


AT_ONCE = 4096
"""Windows whose motion is held at once."""


def train_direct(
    begin: Begin,
    windows: MotionWindows,
    held_out: MotionWindows | None,
    vq: VQConfig,
    gpt: GPTConfig,
    training: GPTTraining,
) -> DirectMotion:
    """Train transformer and decoders end to end: mean absolute error of the normalised motion.

    `training` is that of the GPT, whose place this takes; the model's `mean` is measured.
    """
    windows = windows.choose(["poses", "onset", "speaker"])
    run = begin(training.schedule.steps(len(windows)))
    speakers = len(windows.statistics.speakers)
    direct = DirectMotion(vq, gpt, speakers)
    channels = Channels.of(windows.statistics, vq.quant).to(run.device)

    def losses(model: nn.Module, batch: dict[str, Tensor]) -> dict[str, Tensor]:
        made = model(batch["onset"], speaker_dropout(batch["speaker"], speakers))
        return stream_errors(made.float(), channels.normalise(batch["poses"]), vq)

    score = None if held_out is None else partial(direct_error, direct, held_out)
    fit(run, "direct", direct, windows, training, losses, score, training.patience)
    places = range(len(windows))
    parts = (windows.chosen(places[i : i + AT_ONCE]) for i in places[::AT_ONCE])
    direct.mean.copy_(mean_for_activity(patterns(direct, part) for part in parts))
    return direct.cpu()


def direct_error(direct: DirectMotion, windows: MotionWindows) -> float:
    """Mean absolute error of the normalised motion of windows, the streams' added."""
    channels, total = Channels.of(windows.statistics, direct.config.quant), 0.0
    with evaluating(direct):
        for made, group in zip(
            patterns(direct, windows).split(64), windows.groups("poses"), strict=True
        ):
            errors = stream_errors(made, channels.normalise(group["poses"]), direct.config)
            total += float(torch.stack(list(errors.values())).sum()) * len(made)
    return total / len(windows)
