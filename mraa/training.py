"""Training of the renderer: reconstruct one frame of a clip from another (MRAA, section 3.5)."""

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor, nn

from data_prep.dataset import Dataset
from data_prep.errors import BadInput
from data_prep.rates import IMAGE_SIZE
from mraa.losses import equivariance_of
from mraa.pairs import Augmentation, FramePairs
from mraa.perceptual import BACKENDS, PerceptualPyramid, backend_of
from mraa.pyramid import PYRAMID_SCALES
from mraa.renderer import Renderer, RendererConfig, from_pixels
from mraa.run import Run, RunConfig
from mraa.sheet import write_sheet


@dataclass(frozen=True)
class RendererTraining:
    """How the renderer is trained; the defaults are MRAA's for 256x256."""

    epochs: int = 100
    repeats: int = 75
    """Times that an epoch goes over the clips."""
    steps: int = 0
    """Optimiser steps; 0 for what epochs, repeats and the data give."""
    batch: int = 14
    rate: float = 2e-4
    betas: tuple[float, float] = (0.5, 0.999)
    milestones: tuple[float, ...] = (0.6, 0.9)
    """Parts of the run after which the rate falls to a tenth (epochs 60 and 90 of 100)."""
    perceptual_backend: str = "auto"
    """What compares the pictures: vgg19, random_vgg, lap or random_vgg+lap (see
    `mraa.perceptual`); auto is vgg19 where its weights are given, else random_vgg+lap."""
    perceptual_weights: str = ""
    """File of VGG19's weights, torchvision's state dict as .pth or .safetensors."""
    perceptual_width: int = 32
    """Width of the fixed random network."""
    perceptual_scales: tuple[float, ...] = PYRAMID_SCALES
    """Resolutions at which deep features are compared; on a CPU the full one costs most."""
    perceptual: float = 10.0
    equivariance_shift: float = 10.0
    equivariance_affine: float = 10.0
    occlusion_cost: float = 0.0
    """Not in the paper: weight of mean(1 - occlusion), so that the generator paints only where the
    deformed source cannot serve; a person unlike those of the training then stays that person."""
    blend: float = 0.0
    """Not in the paper: weight, beside `perceptual`, of the warm-up's loss in the main course. It
    holds the masks on what they have found while the generator is still poor."""
    clip: float = 10.0
    """Largest norm of the gradients; those of the affine grow for round regions."""
    augmentation: Augmentation = field(default_factory=Augmentation)
    initial: str = ""
    """Not in the paper: weights to begin with, a `renderer.safetensors` of the same sizes."""
    freeze_estimator: bool = False
    """Not in the paper: keep the region estimator as it is (a teacher); no equivariance losses."""
    sheet_every: int = 500
    """Steps between sheets of samples."""
    warmup_steps: int = 0
    """Not in the paper: steps before the others in which the deformed sources, blended by the
    masks, have to match the small driving frame; the generator rests. A blend of pictures tells a
    mask which region fits however far that moved, a blend of flows only how to move a little, and a
    generator would paint a blur over what moves before any region has found it. Images are reduced
    to `warmup_size`, which estimator and flow predictor see at the same resolution as later."""
    warmup_size: int = 128
    warmup_gap: int = 12
    """Largest distance in frames of a pair in the warm-up: hands that jump across the picture give
    no gradient to a region that is not on them yet."""

    def __post_init__(self) -> None:
        if min(self.batch, self.epochs, self.repeats, self.sheet_every) < 1 or self.steps < 0:
            raise ValueError("batch, epochs, repeats and sheet_every must be positive")
        if not 0 < self.rate < 1 or not all(0 <= beta < 1 for beta in self.betas):
            raise ValueError("rate and betas must lie between 0 and 1")
        if self.clip <= 0 or min(self.warmup_steps, self.warmup_gap, self.augmentation.zoom) < 0:
            raise ValueError("clip must be positive, warm-up and zoom not negative")
        if self.augmentation.zoom >= 1 or not self.perceptual_scales:
            raise ValueError("zoom must lie below 1, and perceptual_scales name at least one")
        if self.perceptual_backend not in ("auto", *BACKENDS):
            raise ValueError(f"perceptual_backend is auto, {', '.join(BACKENDS)}")
        if self.backend == "vgg19" and not self.perceptual_weights:
            raise ValueError("perceptual_backend vgg19 needs its file in perceptual_weights")
        if self.warmup_size not in (64, 128, 256):
            raise ValueError("warmup_size is 64, 128 or 256")

    @property
    def backend(self) -> str:
        """Name of the perceptual backend that these settings mean."""
        return backend_of(self.perceptual_backend, self.perceptual_weights)


class _Objective(nn.Module):
    """The renderer with its losses, as one module so that devices see one forward pass."""

    def __init__(
        self, renderer: Renderer, training: RendererTraining, motion_alone: bool = False
    ) -> None:
        super().__init__()
        self.renderer, self.training_config = renderer, training
        self.motion_alone = motion_alone

    def forward(self, source: Tensor, driving: Tensor) -> dict[str, Tensor]:
        renderer, weights = self.renderer, self.training_config
        frozen = weights.freeze_estimator
        with torch.set_grad_enabled(torch.is_grad_enabled() and not frozen):
            renderer.estimator.train(self.training and not frozen)
            both = renderer.estimator(torch.cat([source, driving]))
        source_regions, driving_regions = both[: len(source)], both[len(source) :]
        background = renderer.background(source, driving)
        flow = renderer.flow(source, source_regions, driving_regions, background)
        nothing = flow.occlusion.new_zeros(())
        terms = {"shift": nothing, "affine": nothing, "painted": nothing, "blend": flow.blend}
        if not self.motion_alone:
            terms["prediction"] = renderer.generator(source, flow)
            terms["painted"] = weights.occlusion_cost * (1 - flow.occlusion).mean()
        if not frozen:
            losses = equivariance_of(
                renderer.estimator,
                driving,
                driving_regions,
                align_corners=renderer.config.align_corners,
            )
            terms["shift"] = weights.equivariance_shift * losses.shift
            terms["affine"] = weights.equivariance_affine * losses.affine
        return terms


def train_renderer(
    dataset: Dataset,
    config: RendererConfig,
    training: RendererTraining,
    folder: Path,
    *,
    seed: int = 0,
    run_config: RunConfig | None = None,
    resume: bool = False,
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
        _train(dataset, taught, training, folder, small, **how)
        take_weights(renderer, taught)
    milestones = tuple(round(part * steps) for part in training.milestones)
    full = RendererStage("renderer", steps, IMAGE_SIZE, milestones)
    _train(dataset, renderer, training, folder, full, **how)
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
        renderer.load_state_dict({k: v.float() for k, v in load_file(path).items()})
    except (OSError, SafetensorError, RuntimeError) as error:
        reason = str(error).splitlines()[0]
        raise BadInput(f"{path}: not the weights of such a renderer ({reason})") from error


def take_weights(renderer: Renderer, taught: Renderer) -> None:
    """Copy all weights but the low-pass kernels, which depend on the image size."""
    kept = {k: v for k, v in renderer.state_dict().items() if k.endswith("down.kernel")}
    given = {k: v for k, v in taught.state_dict().items() if not k.endswith("down.kernel")}
    renderer.load_state_dict({**kept, **given})


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
) -> None:
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
    adam = torch.optim.Adam(renderer.parameters(), lr=training.rate, betas=training.betas)
    objective, optimizer = run.setup(_Objective(renderer, training, stage.motion_alone), adam)
    perceptual = PerceptualPyramid(
        training.backend,
        training.perceptual_weights,
        training.perceptual_width,
        training.perceptual_scales,
        training.perceptual,
    ).to(run.device, memory_format=torch.channels_last)  # type: ignore[call-overload]
    pairs = FramePairs(
        dataset, dataset.clips("train"), training.augmentation, stage.size, stage.gap
    )
    batches = run.batches(pairs, training.batch)
    for step in run.steps():
        run.rate(optimizer, training.rate, stage.milestones)
        pair = next(batches)  # (B, 2, H, W, 3) uint8
        source, driving = (
            from_pixels(x).contiguous(memory_format=torch.channels_last) for x in pair.unbind(1)
        )
        terms = objective(source, driving)
        small = renderer.flow.down(driving)
        if stage.motion_alone:
            prediction, truth = terms["blend"], small
        else:
            prediction, truth = terms["prediction"], driving
        with run.fabric.autocast():
            reconstruction = perceptual(prediction, truth)
            if training.blend and not stage.motion_alone:
                reconstruction = reconstruction + training.blend * perceptual(terms["blend"], small)
        loss = reconstruction + terms["shift"] + terms["affine"] + terms["painted"]
        run.backward(loss)
        run.clip(objective, optimizer, training.clip)
        optimizer.step()
        optimizer.zero_grad()
        run.log(
            loss=loss,
            perceptual=reconstruction,
            shift=terms["shift"],
            affine=terms["affine"],
            painted=terms["painted"],
            l1=(prediction - truth).abs().mean(),
        )
        last = step + 1 == stage.steps
        if run.fabric.global_rank == 0 and (step % training.sheet_every == 0 or last):
            path = folder / "sheets" / f"{stage.name}-{step:07d}.png"
            write_sheet(path, renderer, source, driving)
