"""Training of the motion refiner on the patterns of a frozen VQ motion extractor."""

from dataclasses import dataclass, field
from pathlib import Path

import torch
from torch import Tensor

from angie.motion import integrate
from angie.refiner import Refiner, RefinerConfig
from angie.schedule import BestWeights, Schedule
from angie.train_vq import decode_windows, encode_windows
from angie.vq import VQMotionExtractor
from angie.windows import MotionWindows
from mraa.run import Run, RunConfig


@dataclass(frozen=True)
class RefinerTraining:
    """Training of the refiner.

    Attributes:
        schedule: Adam 1e-4 with betas (0.9, 0.999), batch 32, 100 epochs.
        drifting: share of the windows that get a random linear drift to remove.
        checks: evenly spaced evaluations on the held-out windows.
    """

    schedule: Schedule = field(
        default_factory=lambda: Schedule(rate=1e-4, betas=(0.9, 0.999), epochs=100)
    )
    drifting: float = 0.5
    checks: int = 50

    def __post_init__(self) -> None:
        if self.checks < 1 or not 0 <= self.drifting <= 1:
            raise ValueError("checks must be positive, drifting a share")


def pattern_windows(vq: VQMotionExtractor, windows: MotionWindows) -> MotionWindows:
    """Windows with `poses`, `mfcc` and the deltas of their pattern, `deltas` (T, 5K)."""
    decoded = decode_windows(vq, encode_windows(vq, windows))
    decoded = decoded * windows.statistics.delta_scale
    return windows.choose(["poses", "mfcc"], deltas=decoded)


def pattern_and_truth(batch: dict[str, Tensor], scale: Tensor) -> tuple[Tensor, Tensor]:
    """Pattern and true motion (B, T, 5K) of a batch, in units of the pose scale.

    The pattern is integrated from the true first frame, as generation does from the photo.
    """
    truth = batch["poses"][:, 1:]
    return integrate(batch["deltas"], truth[:, 0]) / scale, truth / scale


def drift_slopes(windows: MotionWindows, at_once: int = 64) -> Tensor:
    """95th percentile (5K,) of the slope, per frame, at which patterns drift from the truth."""
    slopes = []
    for first in range(0, len(windows), at_once):
        batch = {part: windows.stack(part, first, first + at_once) for part in ("poses", "deltas")}
        pattern, truth = pattern_and_truth(batch, windows.statistics.pose_scale)
        slopes.append((pattern - truth)[:, -1].abs() / max(1, truth.shape[1] - 1))
    return torch.cat(slopes).quantile(0.95, dim=0)


def add_drift(pattern: Tensor, slopes: Tensor, share: float) -> Tensor:
    """Add a random linear drift, slope uniform in +-`slopes`, to a share of the windows."""
    batch, frames, channels = pattern.shape
    device = pattern.device
    slope = (2 * torch.rand(batch, 1, channels, device=device) - 1) * slopes
    chosen = torch.rand(batch, 1, 1, device=device) < share
    place = torch.arange(frames, device=device, dtype=pattern.dtype)[:, None]
    return pattern + chosen * slope * place


def refiner_loss(residual: Tensor, pattern: Tensor, truth: Tensor) -> Tensor:
    """Mean absolute error of shift plus that of the Cholesky factor, |M - M^| (equation 10)."""
    error = (pattern + residual.float() - truth).abs()
    split = error.shape[-1] // 5 * 2
    return error[..., :split].mean() + error[..., split:].mean()


def train_refiner(
    folder: Path,
    vq: VQMotionExtractor,
    windows: MotionWindows,
    held_out: MotionWindows | None,
    config: RefinerConfig,
    training: RefinerTraining,
    *,
    seed: int = 0,
    run_config: RunConfig | None = None,
    resume: bool = False,
) -> Refiner:
    """Train the refiner to lead patterns of true codes to the true motion.

    Args:
        folder: where checkpoint and curves go.
        vq: the trained extractor, frozen.
        windows: training windows.
        held_out: windows of other clips, to keep the weights that do best on them; or None.
        config: architecture.
        training: how to train.
        seed: everything random follows from it.
        run_config: device, precision and so on.
        resume: go on from the checkpoint in `folder`.

    Returns:
        The trained refiner in evaluation mode.
    """
    schedule, items = training.schedule, len(windows)
    steps = schedule.steps(items)
    every = max(1, steps // training.checks)
    run = Run(folder, "refiner", steps=steps, seed=seed, config=run_config, resume=resume)
    vq = vq.to(run.device)
    windows = pattern_windows(vq, windows)
    held_out = None if held_out is None else pattern_windows(vq, held_out)
    refiner = Refiner(config)
    best = BestWeights(refiner)
    model, optimizer = run.setup(best, schedule.adam(refiner))
    batches = run.batches(windows, schedule.batch)
    scale = windows.statistics.pose_scale.to(run.device)
    slopes = drift_slopes(windows).to(run.device)
    model.train()
    for step in run.steps():
        run.rate(optimizer, schedule.rate, schedule.milestone_steps(items))
        batch = next(batches)
        pattern, truth = pattern_and_truth(batch, scale)
        pattern = add_drift(pattern, slopes, training.drifting)
        loss = refiner_loss(model(batch["mfcc"], pattern), pattern, truth)
        run.backward(loss)
        run.clip(model, optimizer, schedule.clip)
        optimizer.step()
        optimizer.zero_grad()
        if held_out is not None and (step + 1) % every == 0:
            best.consider(run.fabric.broadcast(held_out_loss(refiner, held_out)))
        run.log(loss=loss, **best.scores())
    best.restore()
    return refiner.eval().cpu()


@torch.no_grad()
def held_out_loss(refiner: Refiner, windows: MotionWindows, at_once: int = 64) -> float:
    """Mean loss of pattern windows without added drift."""
    scale, training = windows.statistics.pose_scale, refiner.training
    device = refiner.shift.out.weight.device
    refiner.eval()
    total = 0.0
    for first in range(0, len(windows), at_once):
        parts = ("poses", "mfcc", "deltas")
        batch = {part: windows.stack(part, first, first + at_once) for part in parts}
        pattern, truth = (value.to(device) for value in pattern_and_truth(batch, scale))
        residual = refiner(batch["mfcc"].to(device), pattern)
        total += float(refiner_loss(residual, pattern, truth)) * len(pattern)
    refiner.train(training)
    return total / len(windows)
