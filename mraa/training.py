"""Training of the renderer: reconstruct one frame of a clip from another (MRAA, section 3.5)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import nn

from data_prep.dataset import Dataset
from data_prep.rates import IMAGE_SIZE
from mraa.initial import load_initial, reduced, reduced_estimator, take_weights
from mraa.objective import Objective, images
from mraa.pairs import FramePairs
from mraa.perceptual import PerceptualPyramid
from mraa.regions import RegionEstimator
from mraa.renderer import Renderer, RendererConfig
from mraa.renderer_training import RendererTraining
from mraa.run import Run, RunConfig
from mraa.sheet import sample_sheet, write_sheet


def train_renderer(
    dataset: Dataset,
    config: RendererConfig,
    training: RendererTraining,
    folder: Path,
    *,
    seed: int = 0,
    run_config: RunConfig | None = None,
    resume: bool = False,
    teacher: RegionEstimator | None = None,
) -> Renderer:
    """Train a renderer on the training clips of a dataset.

    Args:
        dataset: clips of one or several speakers.
        config: architecture.
        training: losses, schedule, augmentation.
        folder: for checkpoint, curves and sample sheets.
        seed: of weights, pairs, augmentation and transforms.
        run_config: device, precision and so on.
        resume: go on from the checkpoint in `folder`.
        teacher: trained region estimator to follow, with `training.distill_weight`.

    Returns:
        The renderer in eval mode on the CPU.
    """
    clips = dataset.clips("train")
    steps = training.steps or max(
        1, training.epochs * training.repeats * len(clips) // training.batch
    )
    torch.manual_seed(seed)
    renderer = Renderer(config)
    if training.initial:
        load_initial(renderer, Path(training.initial))
    how: dict[str, Any] = {"seed": seed, "run_config": run_config, "resume": resume}
    if training.warmup_steps:
        size = training.warmup_size
        small = RendererStage("warmup", training.warmup_steps, size, (), True, training.warmup_gap)
        taught = Renderer(reduced(config, size))
        take_weights(taught, renderer)
        smaller = None if teacher is None else reduced_estimator(teacher, size)
        _train(dataset, taught, training, folder, small, teacher=smaller, **how)
        take_weights(renderer, taught)
    milestones = tuple(round(part * steps) for part in training.milestones)
    full = RendererStage("renderer", steps, IMAGE_SIZE, milestones)
    _train(dataset, renderer, training, folder, full, teacher=teacher, **how)
    return renderer.cpu().eval()


@dataclass(frozen=True)
class RendererStage:
    """One course of training.

    Attributes:
        name: of its checkpoint and curves.
        steps: of the optimiser.
        size: of the images in pixels.
        milestones: steps at which the rate falls.
        motion_alone: compare the blend of deformed sources; the generator rests.
        gap: largest distance in frames of a pair, 0 for any.
    """

    name: str
    steps: int
    size: int
    milestones: tuple[int, ...]
    motion_alone: bool = False
    gap: int = 0


def _train(
    dataset: Dataset,
    renderer: Renderer,
    training: RendererTraining,
    folder: Path,
    stage: RendererStage,
    *,
    seed: int,
    run_config: RunConfig | None,
    resume: bool,
    teacher: RegionEstimator | None,
) -> None:
    """One course of training; `renderer` is left with the weights to publish."""
    run = Run(
        folder,
        stage.name,
        steps=stage.steps,
        seed=seed,
        config=run_config,
        resume=resume,
        resting=stage.motion_alone or training.freeze_estimator,
    )
    renderer.to(memory_format=torch.channels_last)
    compare = perceptual_loss(training).to(run.device, memory_format=torch.channels_last)  # type: ignore[call-overload]
    if teacher is not None:
        teacher = teacher.to(run.device).eval().requires_grad_(False)
    whole = Objective(renderer, training, compare, teacher, stage.motion_alone)
    objective, optimizer = run.setup(whole, adam(renderer, training, fused=not run.scaled))
    clips = dataset.clips("train")
    pairs = FramePairs(dataset, clips, training.augmentation, stage.size, stage.gap)
    batches = run.batches(pairs, training.batch, training.accumulate)
    for step in run.steps():
        run.rate(optimizer, training.rate, stage.milestones)
        for _ in run.parts(objective, training.accumulate):
            pair = next(batches)
            terms = objective(pair.frames, pair.plate)
            error = terms.pop("l1")
            loss = torch.stack(list(terms.values())).sum()
            run.backward(loss / training.accumulate)
            run.log(loss=loss, **terms, l1=error)
        run.clip(objective, optimizer, training.clip)
        optimizer.step()
        optimizer.zero_grad()
        if whole.average is not None:
            whole.average.update(renderer)
        last = step + 1 == stage.steps
        if run.fabric.global_rank == 0 and (step % training.sheet_every == 0 or last):
            sheet = sample_sheet(whole.best, *images(pair.frames))
            write_sheet(folder / "sheets" / f"{stage.name}-{step:07d}.png", sheet)
            run.curves.image("samples", sheet, step)
    renderer.load_state_dict(whole.best.state_dict())


def adam(model: nn.Module, training: RendererTraining, *, fused: bool = True) -> torch.optim.Adam:
    """The optimiser; `fused` takes one pass over memory in place of ten, but no loss scale."""
    parameters = model.parameters()
    return torch.optim.Adam(parameters, lr=training.rate, betas=training.betas, fused=fused)


def perceptual_loss(training: RendererTraining) -> PerceptualPyramid:
    """The perceptual loss that the settings name."""
    return PerceptualPyramid(
        training.backend,
        training.perceptual_weights,
        training.perceptual_width,
        training.perceptual_scales,
        training.perceptual,
    )
