"""What the renderer is trained to make small (MRAA, section 3.5)."""

import torch
from torch import Tensor, nn

from mraa.affine import cholesky
from mraa.ema import AveragedModel
from mraa.flow import Flow
from mraa.losses import equivariance_of
from mraa.perceptual import PerceptualPyramid
from mraa.regions import RegionEstimator, Regions
from mraa.renderer import Renderer, from_pixels
from mraa.renderer_training import RendererTraining
from mraa.transform import thin_plate


class Objective(nn.Module):
    """The renderer with its losses, as one module so that devices see one forward pass.

    Its state is that of the renderer and of the average; what is fixed stays out of checkpoints.

    Args:
        renderer: in training.
        training: weights of the losses.
        compare: the perceptual loss.
        teacher: frozen estimator whose regions are to be followed.
        motion_alone: the generator rests; the blend of deformed sources has to match the small
            driving frame.
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
        self.average = AveragedModel(renderer, training.ema) if training.ema else None
        self._fixed = (compare, teacher)  # in a tuple, where torch does not look for state

    @property
    def best(self) -> Renderer:
        """The renderer to look at and to publish: the averaged one, where there is one."""
        best = self.renderer if self.average is None else self.average.model
        assert isinstance(best, Renderer)
        return best

    def forward(self, frames: Tensor, plate: Tensor) -> dict[str, Tensor]:
        """Losses of pairs.

        Args:
            frames: (B, 2, H, W, 3) uint8, source first.
            plate: (B, 31) standard normal numbers of the equivariance transform.

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
            **self._regions(driving, driving_regions, plate),
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

    def _regions(self, driving: Tensor, regions: Regions, plate: Tensor) -> dict[str, Tensor]:
        """Terms "shift" and "affine", the equivariance; zero while the estimator is frozen."""
        weights, renderer = self.weights, self.renderer
        if weights.freeze_estimator:
            return dict.fromkeys(("shift", "affine"), regions.shift.new_zeros(()))
        losses = equivariance_of(
            renderer.estimator,
            driving,
            regions,
            thin_plate(plate.float()),
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
