"""Training of the disentanglement network on region motion (MRAA, sections 3.4 and 4)."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from data_prep.errors import BadInput
from mraa.avd import AvdNetwork
from mraa.motion import Motion
from mraa.regions import Regions, regions_from_motion
from mraa.renderer import RendererConfig, make_avd
from mraa.training.checkpoint import Schedule
from mraa.training.run import Run, RunConfig


@dataclass(frozen=True)
class AvdTraining:
    """Training of the disentanglement network; the defaults are MRAA's.

    Attributes:
        schedule: Adam 1e-3, batch 256, 30 epochs, the rate falls at 20 and 25.
        repeats: pairs of a clip in an epoch (150 to 2000 in MRAA, by dataset).
        scale: the pose's body is stretched by up to this part, across and down apart.
        with_all: whether `--stage all` trains the network too; only driving videos use it.
    """

    schedule: Schedule = field(
        default_factory=lambda: Schedule(rate=1e-3, batch=256, epochs=30, milestones=(20, 25))
    )
    repeats: int = 150
    scale: float = 0.25
    with_all: bool = False

    def __post_init__(self) -> None:
        if self.repeats < 1 or not 0 <= self.scale < 1:
            raise ValueError("repeats must be positive, scale at least 0 and below 1")


class RegionPairs:
    """Pairs of frames of one clip: whose body it is, and which pose to take.

    Regions are measured once, on frames as they are; MRAA measures them anew on flipped and
    recoloured frames.

    Args:
        motions: region motion of each clip.
    """

    def __init__(self, motions: list[Motion]) -> None:
        self.motions = [motion for motion in motions if motion.frames > 1]
        if not self.motions:
            raise BadInput("no clip has two frames to train the disentanglement network on")

    def __len__(self) -> int:
        """Number of clips."""
        return len(self.motions)

    def draw(self, index: int, random: np.random.Generator) -> Tensor:
        """Motion vectors (2, 5K) of two frames of clip `index`, in random order of time."""
        motion = self.motions[index]
        frames = random.choice(motion.frames, size=2, replace=False)
        vectors = [motion[int(f) : int(f) + 1].vector() for f in frames]
        return torch.cat(vectors)


def regions_of(vectors: Tensor, mode: str) -> Regions:
    """Regions (B, K) of motion vectors (B, 5K), with affines of the renderer's mode."""
    motion = Motion.from_vector(vectors)
    return regions_from_motion(motion.shift, motion.covariance(), mode)


def stretched(regions: Regions, scale: Tensor) -> Regions:
    """The regions of a body that is stretched by `scale` (B, 2), across and down."""
    affine = scale[:, None, :, None] * regions.affine
    return Regions(scale[:, None] * regions.shift, affine @ affine.mT, affine)


class _Objective(nn.Module):
    """The network with its loss, from tensors to tensors so that devices see one forward pass."""

    def __init__(self, avd: AvdNetwork, mode: str, scale: float) -> None:
        super().__init__()
        self.avd, self.mode, self.scale = avd, mode, scale

    def forward(self, pairs: Tensor) -> dict[str, Tensor]:
        """Mean absolute errors of shift and affine for motion vectors (B, 2, 5K)."""
        body, truth = (regions_of(x, self.mode) for x in pairs.unbind(1))
        factor = 1 + self.scale * (2 * torch.rand(len(pairs), 2, device=pairs.device) - 1)
        found = self.avd(body, stretched(truth, factor))
        return {
            "shift": (found.shift - truth.shift).abs().mean(),
            "affine": (found.affine - truth.affine).abs().mean(),
        }


def train_avd(
    folder: Path,
    motions: list[Motion],
    config: RendererConfig,
    training: AvdTraining,
    *,
    seed: int = 0,
    run_config: RunConfig | None = None,
    resume: bool = False,
) -> AvdNetwork:
    """Train the network to put one frame's body into the pose of a stretched other frame.

    The loss is L1 of shift and affine against the other frame unstretched: body from the one,
    pose from the other.

    `motions`: region motion of the training clips. `config`: of the renderer, whose regions and
    affine mode these are.

    Returns:
        The trained network in evaluation mode on the CPU.
    """
    schedule, pairs = training.schedule, RegionPairs(motions)
    items = len(pairs) * training.repeats
    steps = schedule.steps(items)
    run = Run(folder, "avd", steps=steps, seed=seed, config=run_config, resume=resume)
    avd = make_avd(config)
    objective = _Objective(avd, config.affine_mode, training.scale)
    model = run.add("avd", objective, schedule.adam(avd), schedule.milestone_steps(items))
    batches = run.batches(pairs, schedule.batch)
    for _ in run.steps():
        terms = model(next(batches))
        loss = terms["shift"] + terms["affine"]
        run.update(loss, "avd", clip=schedule.clip)
        run.log(loss=loss, **terms)
    return avd.eval().cpu()


@dataclass(frozen=True)
class Recovery:
    """How well poses of stretched bodies are put back onto the body, mean absolute errors."""

    shift: float
    affine: float
    given_shift: float
    """Error of the stretched regions as they are given."""
    given_affine: float

    def __str__(self) -> str:
        """One line."""
        return (
            f"poses of a stretched body put back with shift off by {self.shift:.4f} "
            f"(as given {self.given_shift:.4f}), affine by {self.affine:.4f} "
            f"(as given {self.given_affine:.4f})"
        )


@torch.no_grad()
def recovery(
    avd: AvdNetwork, motions: list[Motion], config: RendererConfig, scale: float, pairs: int = 1024
) -> Recovery:
    """Measure a network in evaluation mode on clips that it was not trained on.

    `avd`: the network, on the CPU. `scale`: bodies are stretched by up to this part, as in
    training.
    """
    random = np.random.default_rng(0)
    drawn = RegionPairs(motions)
    vectors = torch.stack([drawn.draw(i % len(drawn), random) for i in range(pairs)])
    body, truth = (regions_of(x, config.affine_mode) for x in vectors.unbind(1))
    factors = 1 + scale * (2 * torch.from_numpy(random.random((pairs, 2))).float() - 1)
    given = stretched(truth, factors)
    found = avd(body, given)

    def off(a: Tensor, b: Tensor) -> float:
        return round(float((a - b).abs().mean()), 5)

    return Recovery(
        shift=off(found.shift, truth.shift),
        affine=off(found.affine, truth.affine),
        given_shift=off(given.shift, truth.shift),
        given_affine=off(given.affine, truth.affine),
    )
