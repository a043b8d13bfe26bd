"""Training of the renderer: reconstruct one frame of a clip from another (MRAA, section 3.5).

Weights to begin with: of a file, or of a training on smaller images.
"""

import copy
import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import torch
from safetensors import SafetensorError
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel

from data_prep.dataset import Dataset
from data_prep.errors import BadInput
from data_prep.rates import IMAGE_SIZE
from data_prep.tensors import load_tensors
from mraa.blocks import AntiAliasDown
from mraa.perceptual import PerceptualPyramid
from mraa.regions import RegionEstimator
from mraa.renderer import Renderer, RendererConfig
from mraa.training.curves import sample_sheet, write_sheet
from mraa.training.objective import Objective, RendererTraining, images
from mraa.training.pairs import FramePairs, MixedPairs, Share
from mraa.training.run import Run, RunConfig


def reduced(config: RendererConfig, size: int) -> RendererConfig:
    """The renderer for images of `size` pixels whose hourglasses work at the same resolution."""
    factor = IMAGE_SIZE / size
    scales = ("estimator_scale", "flow_scale", "background_scale")
    changed = {name: min(1.0, getattr(config, name) * factor) for name in scales}
    return dataclasses.replace(config, **changed)


def load_initial(renderer: Renderer, path: Path) -> None:
    """Load weights from a safetensors file.

    Raises:
        BadInput: missing, unreadable, or of other sizes.
    """
    try:
        given = load_tensors(path)
    except (OSError, SafetensorError) as error:
        reason = str(error).splitlines()[0]
        raise BadInput(f"{path}: not the weights of a renderer ({reason})") from error
    wanted = renderer.state_dict()
    for name, value in wanted.items():
        if name not in given:
            raise BadInput(f"{path}: not the weights of such a renderer (it has no {name})")
        if given[name].shape != value.shape:
            there, here = ("x".join(map(str, x.shape)) for x in (given[name], value))
            raise BadInput(f"{path}: {name} is {there} there and {here} here; give the same sizes")
    if len(given) > len(wanted):
        other = min(given.keys() - wanted.keys())
        raise BadInput(f"{path}: not the weights of such a renderer ({other} has no place)")
    renderer.load_state_dict({k: v.to(wanted[k].dtype) for k, v in given.items()})


def take_weights(renderer: Renderer, taught: Renderer) -> None:
    """Copy all weights but the low-pass kernels, which depend on the image size."""
    kept = {k: v for k, v in renderer.state_dict().items() if k.endswith("down.kernel")}
    given = {k: v for k, v in taught.state_dict().items() if not k.endswith("down.kernel")}
    renderer.load_state_dict({**kept, **given})


def reduced_estimator(estimator: RegionEstimator, size: int) -> RegionEstimator:
    """The same estimator for images of `size` pixels; its hourglass sees them as before."""
    smaller = copy.deepcopy(estimator)
    smaller.down = AntiAliasDown(3, min(1.0, IMAGE_SIZE / size / estimator.down.step))
    return smaller


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
    also: Sequence[Share] = (),
) -> Renderer:
    """Train a renderer on the training clips of one or several datasets.

    `teacher`: trained region estimator to follow, with `training.distill_weight`. `also`: further
    datasets.

    Returns:
        The renderer in eval mode on the CPU.
    """
    clips = sum(len(one.clips("train")) for one in (dataset, *(part.dataset for part in also)))
    steps = training.steps or max(1, training.epochs * training.repeats * clips // training.batch)
    torch.manual_seed(seed)
    renderer = Renderer(config)
    if training.initial:
        load_initial(renderer, Path(training.initial))
    how: dict[str, Any] = {"seed": seed, "run_config": run_config, "resume": resume, "also": also}
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
    also: Sequence[Share],
) -> None:
    """One course of training; `renderer` is left with the weights to publish."""
    run = Run(
        folder,
        stage.name,
        steps=stage.steps,
        seed=seed,
        config=run_config,
        resume=resume,
        unused_parameters=stage.motion_alone or training.freeze_estimator,
    )
    renderer.to(memory_format=torch.channels_last)
    compare = perceptual_loss(training).to(run.device, memory_format=torch.channels_last)  # type: ignore[call-overload]
    if teacher is not None:
        teacher = teacher.to(run.device).eval().requires_grad_(False)
    average = moving_average(renderer, training.ema) if training.ema else None
    objective = run.add(
        "renderer",
        Objective(renderer, training, compare, teacher, stage.motion_alone),
        adam(renderer, training, fused=not run.scaled),
        stage.milestones,
    )
    best = renderer
    if average is not None:
        run.add("average", average)
        best = cast(Renderer, average.module)
    pairs = pairs_of(dataset, also, training, stage)
    batches = run.batches(pairs, training.batch, training.accumulate)
    for step in run.steps():
        for _ in run.parts(training.accumulate, "renderer"):
            pair = next(batches)
            terms = objective(pair.frames, pair.tps_noise)
            error = terms.pop("l1")
            loss = torch.stack(list(terms.values())).sum()
            run.update(loss, "renderer", clip=training.clip)
            run.log(loss=loss, **terms, l1=error)
        if average is not None:
            average.update_parameters(renderer)
        last = step + 1 == stage.steps
        if run.fabric.global_rank == 0 and (step % training.sheet_every == 0 or last):
            sheet = sample_sheet(best, *images(pair.frames))
            write_sheet(folder / "sheets" / f"{stage.name}-{step:07d}.png", sheet)
            run.curves.image("samples", sheet, step)
    renderer.load_state_dict(best.state_dict())


def pairs_of(
    dataset: Dataset, also: Sequence[Share], training: RendererTraining, stage: RendererStage
) -> FramePairs | MixedPairs:
    """The pairs of a course of training."""
    parts = [
        FramePairs(one, one.clips("train"), training.augmentation, stage.size, stage.gap)
        for one in (dataset, *(share.dataset for share in also))
    ]
    return MixedPairs(parts, [1.0, *(share.weight for share in also)]) if also else parts[0]


def moving_average(model: nn.Module, decay: float) -> AveragedModel:
    """A copy of a model whose weights and buffers follow it as an exponential moving average.

    After n updates the average keeps min(decay, (1 + n) / (10 + n)) of itself, so that the first
    weights do not count for long. The number of updates is part of the state.

    Args:
        model: in training; its parameters must not be replaced.
        decay: in (0, 1).

    Returns:
        In evaluation mode; `update_parameters(model)` moves it, `module` is the average.
    """

    def average(averages: list[Tensor], latest: list[Tensor], updates: Tensor) -> None:
        kept = torch.clamp((1 + updates) / (10 + updates), max=decay)
        for mean, value in zip(averages, latest, strict=True):
            if mean.is_floating_point():
                mean.lerp_(value, 1 - kept)
            else:  # such as the number of batches that a batch norm has seen
                mean.copy_(value)

    averaged = AveragedModel(model, multi_avg_fn=average, use_buffers=True)  # type: ignore[arg-type]
    averaged.n_averaged.fill_(1)  # at 0 torch copies the weights in place of averaging them
    return averaged.eval().requires_grad_(False)


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
