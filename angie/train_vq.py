"""Training of the VQ motion extractor."""

from dataclasses import dataclass, field
from pathlib import Path

import torch
from torch import Tensor

from angie.drift import activity
from angie.motion import deltas
from angie.schedule import Schedule
from angie.vq import VQConfig, VQMotionExtractor
from angie.windows import MotionWindows
from mraa.run import Run, RunConfig


@dataclass(frozen=True)
class VQTraining:
    """Training of the VQ motion extractor; the defaults are the paper's.

    Attributes:
        schedule: Adam 3e-5, batch 32, 500 epochs.
        commitment: weight of the commitment loss (b1 and b2 of equation 9).
        latent: weight of the codebook loss, which is zero under EMA.
    """

    schedule: Schedule = field(default_factory=lambda: Schedule(rate=3e-5))
    commitment: float = 0.1
    latent: float = 1.0


def normalised_deltas(poses: Tensor, scale: Tensor) -> Tensor:
    """Deltas (B, T, 5K) of windows with a leading frame (B, T + 1, 5K), in units of `scale`."""
    return deltas(poses)[:, 1:] / scale


def train_vq(
    folder: Path,
    windows: MotionWindows,
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
        config: architecture.
        training: how to train.
        seed: everything random follows from it.
        run_config: device, precision and so on.
        resume: go on from the checkpoint in `folder`.

    Returns:
        The trained extractor in evaluation mode, its `mean` measured.
    """
    windows = windows.choose(["poses"])
    schedule, items = training.schedule, len(windows)
    steps = schedule.steps(items)
    run = Run(folder, "vq", steps=steps, seed=seed, config=run_config, resume=resume)
    vq = VQMotionExtractor(config)
    model, optimizer = run.setup(vq, schedule.adam(vq))
    batches = run.batches(windows, schedule.batch)
    scale = windows.statistics.delta_scale.to(run.device)
    split = 2 * config.regions
    model.train()
    for _ in run.steps():
        run.rate(optimizer, schedule.rate, schedule.milestone_steps(items))
        target = normalised_deltas(next(batches)["poses"], scale)
        result = model(target)
        error = (result.deltas.float() - target).abs()
        shift, cholesky = error[..., :split].mean(), error[..., split:].mean()
        loss = shift + cholesky
        loss = loss + training.commitment * result.commitment + training.latent * result.latent
        run.backward(loss)
        run.clip(model, optimizer, schedule.clip)
        optimizer.step()
        optimizer.zero_grad()
        run.log(
            loss=loss,
            shift=shift,
            cholesky=cholesky,
            commitment=result.commitment,
            shift_perplexity=vq.shift.codebook.perplexity(),
            cholesky_perplexity=vq.cholesky.codebook.perplexity(),
        )
    vq.eval()
    vq.mean.copy_(decoded_mean(vq, windows))
    return vq.cpu()


@torch.no_grad()
def encode_windows(vq: VQMotionExtractor, windows: MotionWindows, at_once: int = 64) -> Tensor:
    """Codes (n, 2, 12) on the CPU of all windows."""
    windows = windows.choose(["poses"])
    scale = windows.statistics.delta_scale
    codes = []
    for first in range(0, len(windows), at_once):
        poses = windows.stack("poses", first, first + at_once)
        codes.append(vq.encode(normalised_deltas(poses, scale).to(vq.mean.device)).cpu())
    return torch.cat(codes)


@torch.no_grad()
def decode_windows(vq: VQMotionExtractor, codes: Tensor, at_once: int = 64) -> Tensor:
    """Normalised deltas (n, T, 5K) on the CPU of codes (n, 2, S)."""
    parts = [vq.decode(group.to(vq.mean.device)).float().cpu() for group in codes.split(at_once)]
    return torch.cat(parts)


def decoded_mean(vq: VQMotionExtractor, windows: MotionWindows) -> Tensor:
    """Sum (5K,) of the windows' decoded deltas, normalised, divided by their summed activity."""
    total = torch.zeros_like(vq.mean, device="cpu", dtype=torch.float64)
    moved = 0.0
    for group in encode_windows(vq, windows).split(64):
        decoded = decode_windows(vq, group).double()
        total += decoded.sum(dim=(0, 1))
        moved += float(activity(decoded).sum())
    return (total / max(moved, 1e-12)).to(vq.mean)
