"""Training of the VQ motion extractor."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import torch
from torch import Tensor

from angie.generators.angie.codes import STREAMS, mean_for_activity, patterns, reconstruction
from angie.generators.angie.tokenizer import VQConfig, VQMotionExtractor
from angie.motion.channels import Channels
from angie.motion.windows import STRIDE, MotionWindows, check_stride
from mraa.training.checkpoint import Schedule
from mraa.training.run import Run, RunConfig

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
        still_share: largest share of the windows in which nothing moves; 1 keeps all.
        checks: evenly spaced evaluations on the held-out windows, for the curves.
        summed: weight of the mean absolute error of the deltas summed up from the window's
            beginning, which holds patterns near the true path; not in the paper. Channels count
            as they move in the picture: by their scale over the mean scale of their stream.
        summed_norm: "absolute" or "square" of that error; the square, in which wide gestures
            count more, is what the correlation of paths asks for.
        warmup: part of the steps before the codebooks come in; these then begin with the cluster
            centres of the encoders' vectors, not with vectors of one batch. Not in the paper.
    """

    schedule: Schedule = field(default_factory=lambda: Schedule(rate=3e-5))
    commitment: float = 0.1
    latent: float = 1.0
    stride: int = STRIDE
    still_share: float = 1.0
    checks: int = 50
    summed: float = 0.0
    summed_norm: str = field(default="absolute", metadata={"later": True})
    warmup: float = 0.0

    def __post_init__(self) -> None:
        if self.summed_norm not in NORMS:
            raise ValueError(f"summed_norm is one of {', '.join(NORMS)}, not {self.summed_norm!r}")
        if self.checks < 1 or not 0 < self.still_share <= 1 or self.summed < 0:
            raise ValueError(
                "checks must be positive, still_share a share above 0, summed not negative"
            )
        if min(self.commitment, self.latent) < 0:
            raise ValueError("commitment and latent must not be negative")
        if not 0 <= self.warmup < 1:
            raise ValueError("warmup is a part of the steps, below 1")
        check_stride(self.stride)


def train_vq(
    folder: Path,
    windows: MotionWindows,
    held_out: MotionWindows | None,
    config: VQConfig,
    training: VQTraining,
    *,
    seed: int = 0,
    run_config: RunConfig | None = None,
    resume: bool = False,
) -> VQMotionExtractor:
    """Train the VQ motion extractor (ANGIE, equation 9).

    Loss: mean absolute error of the deltas, shift and Cholesky stream each, and the commitment
    (under `update="loss"` also the codebook's) mean squared error.

    Args:
        folder: where checkpoint and curves go.
        windows: training windows; `poses` is used.
        held_out: windows of other clips, to watch reconstruction and use of the codes on; or
            None.
        config: architecture.
        training: how to train.
        seed: everything random follows from it.
        run_config: device, precision and so on.
        resume: go on from the checkpoint in `folder`.

    Returns:
        The trained extractor in evaluation mode, its `mean` measured.
    """
    windows = windows.thinned(training.still_share).choose(["poses"])
    schedule, items = training.schedule, len(windows)
    steps = schedule.steps(items)
    run = Run(folder, "vq", steps=steps, seed=seed, config=run_config, resume=resume)
    vq = VQMotionExtractor(config)
    model, optimizer = run.setup(vq, schedule.adam(vq))
    batches = run.batches(windows, schedule.batch)
    channels = Channels.of(windows.statistics, config.quant).to(run.device)
    weights = torch.cat([part / part.mean() for part in channels.scale.split(config.channels)])
    every, warmup = max(1, steps // training.checks), int(training.warmup * steps)
    model.train()
    for step in run.steps():
        run.rate(optimizer, schedule.rate, schedule.milestone_steps(items))
        target = channels.normalise(next(batches)["poses"])
        if step == warmup > 0:
            vq.begin(channels.normalise(some_poses(windows).to(run.device)))
        result = model(target, step >= warmup)
        errors = stream_errors(result.deltas.float(), target, config)
        loss = torch.stack(list(errors.values())).sum()
        loss = loss + training.commitment * result.commitment + training.latent * result.latent
        if training.summed and bool(channels.relative.any()):
            off = (result.deltas.float() - target) * weights
            path = off[..., channels.relative].cumsum(dim=1)
            errors["summed"] = NORMS[training.summed_norm](path).mean()
            loss = loss + training.summed * errors["summed"]
        run.backward(loss)
        run.clip(model, optimizer, schedule.clip)
        optimizer.step()
        optimizer.zero_grad()
        use = {}
        for name, stream in zip(STREAMS, vq.streams, strict=False):
            use[f"{name}_perplexity"] = stream.codebook.perplexity()
            use[f"{name}_used"] = stream.codebook.used()
        if held_out is not None and (step + 1) % every == 0 and run.fabric.global_rank == 0:
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
