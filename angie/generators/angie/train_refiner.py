"""Training of the motion refiner on the patterns of a frozen VQ motion extractor, or of the GPT."""

from dataclasses import dataclass, field
from functools import partial

import torch
from torch import Tensor, nn

from angie.generators.angie.channels import Channels
from angie.generators.angie.codes import continued_codes, decode_windows, evaluating, patterns
from angie.generators.angie.gpt import CoSpeechGPT
from angie.generators.angie.refiner import Refiner, RefinerConfig
from angie.generators.angie.tokenizer import DirectMotion, VQMotionExtractor
from angie.generators.angie.train import Begin, fit
from angie.motion.windows import STRIDE, MotionWindows, check_stride
from data_prep.errors import BadInput
from data_prep.rates import FRAMES_PER_TOKEN
from mraa.training.checkpoint import Schedule

PATTERNS = ("codes", "gpt")


@dataclass(frozen=True)
class RefinerTraining:
    """Training of the refiner.

    Attributes:
        schedule: Adam 1e-4 with betas (0.9, 0.999), batch 32, 100 epochs.
        pattern: what the refiner leads to the true motion: "codes", the patterns of the true
            motion's own codes, or "gpt", those of the codes that the GPT continues each window's
            first true code with, the likeliest ones.
        drifting: share of the windows that get a random linear drift to remove; not in the paper.
        checks: evenly spaced evaluations on the held-out windows.
        stride: frames from one training window to the next, a multiple of 8.
        velocity: weight of the mean absolute error of the change from frame to frame, in which
            the rhythm is; not in the paper.
    """

    schedule: Schedule = field(
        default_factory=lambda: Schedule(rate=1e-4, betas=(0.9, 0.999), epochs=100)
    )
    pattern: str = "codes"
    drifting: float = 0.0
    checks: int = 50
    stride: int = STRIDE
    velocity: float = 0.0

    def __post_init__(self) -> None:
        if self.pattern not in PATTERNS:
            raise ValueError(f"pattern is one of {', '.join(PATTERNS)}, not {self.pattern!r}")
        if self.checks < 1 or not 0 <= self.drifting <= 1:
            raise ValueError("checks must be positive, drifting a share")
        if self.velocity < 0:
            raise ValueError("velocity must not be negative")
        check_stride(self.stride, FRAMES_PER_TOKEN)


def pattern_windows(
    vq: VQMotionExtractor | DirectMotion, windows: MotionWindows, gpt: CoSpeechGPT | None = None
) -> MotionWindows:
    """Windows with `poses`, `mfcc` and `pattern` (T, 5K), in units of the pose scale.

    The pattern is integrated from the true first frame, as generation does from the photo; it is
    of the true motion's codes, or, with `gpt`, of those that it continues the first one with.
    """
    channels = Channels.of(windows.statistics, vq.config.quant)
    scale = windows.statistics.pose_scale
    if gpt is not None and isinstance(vq, VQMotionExtractor):
        found = decode_windows(vq, continued_codes(gpt, vq, windows))
    else:
        found = patterns(vq, windows)
    made = [
        channels.integrate(values, group["poses"][:, 1]) / scale
        for values, group in zip(found.split(64), windows.groups("poses"), strict=True)
    ]
    return windows.choose(["poses", "mfcc"], pattern=torch.cat(made))


def mean_pose(windows: MotionWindows) -> Tensor:
    """Mean training pose (5K,) in units of the pose scale.

    Raises:
        BadInput: statistics from before it was measured.
    """
    statistics = windows.statistics
    if not len(statistics.pose_mean):
        raise BadInput("refiner.sees=pose: needs newer statistics; run the motion stage")
    return statistics.pose_mean / statistics.pose_scale


def truth_of(batch: dict[str, Tensor], scale: Tensor) -> Tensor:
    """True motion (B, T, 5K) of a batch in units of the pose scale."""
    return batch["poses"][:, 1:] / scale


def drift_slopes(windows: MotionWindows) -> Tensor:
    """95th percentile (5K,) of the slope, per frame, at which patterns drift from the truth."""
    slopes = []
    for group in windows.groups("poses", "pattern"):
        truth = truth_of(group, windows.statistics.pose_scale)
        off = (group["pattern"] - truth)[:, -1].abs()
        slopes.append(off / max(1, truth.shape[1] - 1))
    return torch.cat(slopes).quantile(0.95, dim=0)


def add_drift(pattern: Tensor, slopes: Tensor, share: float) -> Tensor:
    """Add a random linear drift, slope uniform in +-`slopes`, to a share of the windows."""
    batch, frames, channels = pattern.shape
    device = pattern.device
    slope = (2 * torch.rand(batch, 1, channels, device=device) - 1) * slopes
    chosen = torch.rand(batch, 1, 1, device=device) < share
    place = torch.arange(frames, device=device, dtype=pattern.dtype)[:, None]
    return pattern + chosen * slope * place


def refiner_loss(residual: Tensor, pattern: Tensor, truth: Tensor, shifts: int) -> Tensor:
    """Mean absolute error of shift plus that of the Cholesky factor, |M - M^| (equation 10).

    The first `shifts` channels are of the shift; there may be no others.
    """
    error = (pattern + residual.float() - truth).abs()
    parts = error.split([shifts, error.shape[-1] - shifts], dim=-1)
    return torch.stack([part.mean() for part in parts if part.shape[-1]]).sum()


def whole_loss(
    residual: Tensor, pattern: Tensor, truth: Tensor, shifts: int, training: RefinerTraining
) -> Tensor:
    """`refiner_loss` and what `training` adds to it, all in units of the pose scale."""
    loss = refiner_loss(residual, pattern, truth, shifts)
    if training.velocity:
        off = pattern + residual.float() - truth
        loss = loss + training.velocity * off.diff(dim=1).abs().mean()
    return loss


def train_refiner(
    begin: Begin,
    vq: VQMotionExtractor | DirectMotion,
    windows: MotionWindows,
    held_out: MotionWindows | None,
    config: RefinerConfig,
    training: RefinerTraining,
    gpt: CoSpeechGPT | None = None,
) -> Refiner:
    """Train the refiner to lead patterns to the true motion.

    Patterns are of the true codes; with `gpt`, trained on the codes of `vq`, of its codes.
    """
    run = begin(training.schedule.steps(len(windows)))
    vq = vq.to(run.device)
    gpt = None if gpt is None else gpt.to(run.device)
    windows = pattern_windows(vq, windows, gpt)
    scale = windows.statistics.pose_scale.to(run.device)
    slopes = drift_slopes(windows).to(run.device)
    refiner = Refiner(config)
    if config.sees == "pose":
        refiner.mean.copy_(mean_pose(windows))

    def losses(model: nn.Module, batch: dict[str, Tensor]) -> dict[str, Tensor]:
        pattern = add_drift(batch["pattern"], slopes, training.drifting)
        residual, truth = model(batch["mfcc"], pattern), truth_of(batch, scale)
        return {"loss": whole_loss(residual, pattern, truth, config.channels[0], training)}

    score = None
    if held_out is not None:
        score = partial(held_out_loss, refiner, pattern_windows(vq, held_out, gpt), training)
    fit(run, "refiner", refiner, windows, training, losses, score)
    return refiner.cpu()


def held_out_loss(refiner: Refiner, windows: MotionWindows, training: RefinerTraining) -> float:
    """Mean loss, as in training, of pattern windows without added drift."""
    device, total = refiner.shift.out.weight.device, 0.0
    with evaluating(refiner):
        for group in windows.groups("poses", "mfcc", "pattern"):
            truth = truth_of(group, windows.statistics.pose_scale).to(device)
            mfcc, pattern = group["mfcc"].to(device), group["pattern"].to(device)
            residual, split = refiner(mfcc, pattern), refiner.config.channels[0]
            total += float(whole_loss(residual, pattern, truth, split, training)) * len(pattern)
    return total / len(windows)
