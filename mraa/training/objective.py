"""What the renderer is trained to make small (MRAA, section 3.5).

How the renderer is trained: every number of it.
"""

from dataclasses import dataclass, field

import torch
from torch import Tensor, nn

from mraa.affine import cholesky
from mraa.flow import Flow
from mraa.losses import equivariance_of, thin_plate
from mraa.perceptual import BACKENDS, PYRAMID_SCALES, PerceptualPyramid, backend_of
from mraa.regions import RegionEstimator, Regions
from mraa.renderer import Renderer, from_pixels
from mraa.training.pairs import Augmentation


@dataclass(frozen=True)
class RendererTraining:
    """How the renderer is trained; the defaults are MRAA's for 256x256."""

    epochs: int = 100
    repeats: int = 75
    """Times that an epoch goes over the clips."""
    steps: int = 0
    """Optimiser steps; 0 for what epochs, repeats and the data give."""
    batch: int = 14
    """Pairs of an optimiser step, over all processes and parts together."""
    accumulate: int = 1
    """Parts that a batch is computed in, one after the other, for devices of little memory; each
    has its own batch norm statistics."""
    ema: float = 0.0
    """Not in the paper: decay of a moving average of the weights, such as 0.999, which is then
    what is evaluated and published; 0 for none."""
    rate: float = 2e-4
    betas: tuple[float, float] = (0.5, 0.999)
    milestones: tuple[float, ...] = (0.6, 0.9)
    """Parts of the run after which the rate falls to a tenth (epochs 60 and 90 of 100)."""
    perceptual_backend: str = "auto"
    """What compares the pictures: vgg19, random_vgg, lap, random_vgg+lap, imagenet or imagenet+lap
    (see `mraa.perceptual`); auto is vgg19 where its weights are given, else random_vgg+lap."""
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
    """Not in the paper: weights to begin with, a bundle or a `renderer.safetensors` of the same
    sizes."""
    teacher: str = ""
    """A bundle whose region estimator, frozen, says where the regions are (knowledge distillation,
    as ANGIE has it); it has to have as many regions, of whatever other sizes it is."""
    distill_weight: float = 10.0
    """Weight of |mu - mu_T| + |L - L_T|, means over both frames, where there is a teacher; the
    paper states none, this is the weight of the equivariance."""
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
        counts = (self.batch, self.accumulate, self.epochs, self.repeats, self.sheet_every)
        if min(counts) < 1 or self.steps < 0:
            raise ValueError("batch, accumulate, epochs, repeats, sheet_every must be positive")
        weights = (self.perceptual, self.equivariance_shift, self.equivariance_affine)
        if min(*weights, self.occlusion_cost, self.blend) < 0 or self.perceptual_width < 1:
            raise ValueError("weights must not be negative, perceptual_width not below 1")
        if not set(self.perceptual_scales) <= set(PYRAMID_SCALES):
            raise ValueError(f"perceptual_scales are of {', '.join(map(str, PYRAMID_SCALES))}")
        if not all(0 <= part <= 1 for part in self.milestones):
            raise ValueError("milestones are parts of the run in [0, 1]")
        if self.batch % self.accumulate:
            raise ValueError(f"batch {self.batch} does not divide into {self.accumulate} parts")
        if not 0 <= self.ema < 1 or self.distill_weight < 0:
            raise ValueError("ema must lie in [0, 1), distill_weight not be negative")
        if self.teacher and not self.distill_weight:
            raise ValueError("a teacher needs a distill_weight above 0")
        if self.teacher and self.freeze_estimator:
            raise ValueError("a frozen estimator learns nothing from a teacher")
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


class Objective(nn.Module):
    """The renderer with its losses, as one module so that devices see one forward pass.

    Its state is that of the renderer; what is fixed stays out of checkpoints.

    `teacher`: frozen estimator whose regions are to be followed. `motion_alone`: the generator
    rests; the blend of deformed sources has to match the small driving frame.
    """

    def __init__(
        self,
        renderer: Renderer,
        training: RendererTraining,
        compare: PerceptualPyramid,
        teacher: RegionEstimator | None = None,
        motion_alone: bool = False,
    ) -> None:
        super().__init__()
        self.renderer, self.weights, self.motion_alone = renderer, training, motion_alone
        self._fixed = (compare, teacher)  # in a tuple, where torch does not look for state

    def forward(self, frames: Tensor, tps_noise: Tensor) -> dict[str, Tensor]:
        """Losses of pairs.

        Args:
            frames: (B, 2, H, W, 3) uint8, source first.
            tps_noise: (B, 31) standard normal numbers of the equivariance transform.

        Returns:
            The weighted terms of the loss, scalars: "perceptual", "shift", "affine", "painted",
            "taught"; and "l1", the mean absolute error, which is no term of it.
        """
        renderer = self.renderer
        learns = self.training and not self.weights.freeze_estimator
        source, driving = images(frames)
        with torch.set_grad_enabled(torch.is_grad_enabled() and learns):
            renderer.estimator.train(learns)
            both = renderer.estimator(torch.cat([source, driving]))
        source_regions, driving_regions = both[: len(source)], both[len(source) :]
        background = renderer.background(source, driving)
        flow = renderer.flow(source, source_regions, driving_regions, background)
        terms = self._reconstruction(source, driving, flow)
        return {
            **terms,
            **self._regions(driving, driving_regions, tps_noise),
            **self._taught(both, source, driving),
        }

    def _reconstruction(self, source: Tensor, driving: Tensor, flow: Flow) -> dict[str, Tensor]:
        """Terms "perceptual" and "painted", and the error "l1"."""
        weights, (compare, _) = self.weights, self._fixed
        if self.motion_alone:
            prediction, truth = flow.blend, self.renderer.flow.down(driving)
            painted = prediction.new_zeros(())
        else:
            prediction, truth = self.renderer.generator(source, flow), driving
            painted = weights.occlusion_cost * (1 - flow.occlusion).mean()
        loss = compare(prediction, truth)
        if weights.blend and not self.motion_alone:
            loss = loss + weights.blend * compare(flow.blend, self.renderer.flow.down(driving))
        error = (prediction - truth).detach().abs().mean()
        return {"perceptual": loss, "painted": painted, "l1": error}

    def _regions(self, driving: Tensor, regions: Regions, tps_noise: Tensor) -> dict[str, Tensor]:
        """Terms "shift" and "affine", the equivariance; zero while the estimator is frozen."""
        weights, renderer = self.weights, self.renderer
        if weights.freeze_estimator:
            return dict.fromkeys(("shift", "affine"), regions.shift.new_zeros(()))
        losses = equivariance_of(
            renderer.estimator,
            driving,
            regions,
            thin_plate(tps_noise.float()),
            align_corners=renderer.config.align_corners,
        )
        return {
            "shift": weights.equivariance_shift * losses.shift,
            "affine": weights.equivariance_affine * losses.affine,
        }

    def _taught(self, regions: Regions, source: Tensor, driving: Tensor) -> dict[str, Tensor]:
        """Term "taught", weight * (|mu - mu_T| + |L - L_T|); zero without a teacher."""
        teacher = self._fixed[1]
        if teacher is None:
            return {"taught": regions.shift.new_zeros(())}
        with torch.no_grad():
            wanted = teacher(torch.cat([source, driving]))
        shift = (regions.shift - wanted.shift).abs().mean()
        # the three entries of the factor; its fourth is zero in both
        factor = (cholesky(regions.covariance) - cholesky(wanted.covariance)).abs().mean() * 4 / 3
        return {"taught": self.weights.distill_weight * (shift + factor)}


def images(frames: Tensor) -> tuple[Tensor, Tensor]:
    """Sources and drivings (B, 3, H, W) in [0, 1], channels last, of pairs (B, 2, H, W, 3)."""
    source, driving = (
        from_pixels(x).contiguous(memory_format=torch.channels_last) for x in frames.unbind(1)
    )
    return source, driving
