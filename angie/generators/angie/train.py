"""Training of ANGIE's parts: the VQ motion extractor, the co-speech GPT, and motion without codes.

Each is a loss and a score; steps, checkpoints and the choice of the best weights are `Run`'s.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import torch
from torch import Tensor

from angie.generators.angie.codes import (
    STREAMS,
    mean_for_activity,
    patterns,
    reconstruction,
    window_codes,
)
from angie.generators.angie.direct import DirectMotion
from angie.generators.angie.gpt import CoSpeechGPT, GPTConfig
from angie.generators.angie.tokenizer import VQConfig, VQMotionExtractor
from angie.motion.channels import Channels
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
    (under `update="loss"` also the codebook's) mean squared error.

    Args:
        begin: begins the run.
        windows: training windows; `poses` is used.
        held_out: windows of other clips, to watch reconstruction and use of the codes on; or
            None.
        config: architecture.
        training: how to train.

    Returns:
        The trained extractor in evaluation mode, its `mean` measured.
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
            vq.init_codebook(channels.normalise(some_poses(windows).to(run.device)))
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


def some_poses(windows: MotionWindows) -> Tensor:
    """Poses (n, 97, 5K) of at most `CLUSTERED` windows, evenly spread."""
    count = min(len(windows), CLUSTERED)
    chosen = windows.chosen(torch.linspace(0, len(windows) - 1, count).long().tolist())
    return chosen.stack("poses", 0, count)


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

    Args:
        begin: begins the run.
        vq: the trained extractor, frozen.
        windows: training windows.
        held_out: windows of clips that are not in `windows`, or None.
        config: architecture.
        training: how to train.

    Returns:
        The trained GPT in evaluation mode.
    """
    schedule, items = training.schedule, len(windows)
    run = begin(schedule.steps(items))
    vq = vq.to(run.device)
    windows = code_windows(vq, windows)
    held_out = None if held_out is None else code_windows(vq, held_out)
    speakers = len(windows.statistics.speakers)
    gpt = CoSpeechGPT(config, speakers)
    model = run.add("gpt", gpt, schedule.adam(gpt), schedule.milestone_steps(items))
    batches = run.batches(windows, schedule.batch)
    for _ in run.steps():
        batch = next(batches)
        codes, onset = batch["codes"], batch["onset"]
        who = speaker_dropout(batch["speaker"], speakers) if config.joint else None
        loss = gpt.loss(model(codes[..., :-1], onset[:, 1:], who), codes[..., 1:])
        run.update(loss, "gpt", clip=schedule.clip)
        if held_out is not None and run.due(training.checks):
            run.keep_best(cross_entropy(gpt, held_out), training.patience)
        run.log(loss=loss)
    run.restore_best()
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

    Args:
        begin: begins the run.
        windows: training windows.
        held_out: windows of other clips, to choose the weights by; or None.
        vq: sizes of the decoders.
        gpt: sizes of the transformer.
        training: how to train: that of the GPT, whose place this takes.

    Returns:
        The trained model in evaluation mode, its `mean` measured.
    """
    windows = windows.choose(["poses", "onset", "speaker"])
    schedule, items = training.schedule, len(windows)
    run = begin(schedule.steps(items))
    direct = DirectMotion(vq, gpt, len(windows.statistics.speakers))
    model = run.add("direct", direct, schedule.adam(direct), schedule.milestone_steps(items))
    batches = run.batches(windows, schedule.batch)
    channels = Channels.of(windows.statistics, vq.quant).to(run.device)
    for _ in run.steps():
        batch = next(batches)
        who = speaker_dropout(batch["speaker"], len(windows.statistics.speakers))
        made = model(batch["onset"], who)
        errors = stream_errors(made.float(), channels.normalise(batch["poses"]), vq)
        loss = torch.stack(list(errors.values())).sum()
        run.update(loss, "direct", clip=schedule.clip)
        if held_out is not None and run.due(training.checks):
            run.keep_best(direct_error(direct, held_out), training.patience)
        run.log(loss=loss, **errors)
    run.restore_best()
    direct.eval()
    places = range(len(windows))
    parts = (windows.chosen(places[i : i + AT_ONCE]) for i in places[::AT_ONCE])
    direct.mean.copy_(mean_for_activity(patterns(direct, part) for part in parts))
    return direct.cpu()


@torch.no_grad()
def direct_error(direct: DirectMotion, windows: MotionWindows) -> float:
    """Mean absolute error of the normalised motion of windows, the streams' added."""
    training = direct.training
    direct.eval()
    windows = windows.choose(["poses", "onset", "speaker"])
    made = patterns(direct, windows)
    channels = Channels.of(windows.statistics, direct.config.quant)
    total = 0.0
    for first in range(0, len(windows), 64):
        poses = windows.stack("poses", first, first + 64)
        true = channels.normalise(poses)
        errors = stream_errors(made[first : first + 64], true, direct.config)
        total += float(torch.stack(list(errors.values())).sum()) * len(poses)
    direct.train(training)
    return total / len(windows)
