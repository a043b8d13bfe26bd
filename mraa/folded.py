"""A renderer opened on one photo, for inference on a CPU."""

import numpy as np
import torch
from torch import Tensor

from mraa import warp_kernel
from mraa.folded_flow import FoldedFlow, pixels
from mraa.folded_generator import fold_generator
from mraa.parts import Parts
from mraa.regions import Regions
from mraa.renderer import Renderer, Source


class Folded:
    """A renderer opened on one photo, on a CPU.

    Args:
        renderer: in eval mode.
        source: what `Renderer.open` gave.
        count: B, frames at once.
        dtype: of the convolutions.
    """

    def __init__(self, renderer: Renderer, source: Source, count: int, dtype: torch.dtype) -> None:
        self.size = source.image.shape[2:]
        self.photo = warp_kernel.framed(source.image[0].permute(1, 2, 0).numpy())
        self.flow = FoldedFlow(renderer.flow, source.small, source.regions, count, dtype)
        self.generator = fold_generator(renderer.generator, source.features, count, dtype)

    @torch.no_grad()
    def __call__(self, driving: Regions, background: Tensor, painted: bool) -> Parts:
        """Draw B frames; without `painted` the generated picture is left out (of size 0)."""
        field = self.flow(driving, background)
        logits = self.generator(field)
        count, (height, width) = len(field.flow), self.size
        made = np.empty((count, 3, height, width) if painted else (0, 3, 0, 0), np.float32)
        frames = np.empty((count, height, width, 3), np.uint8)
        warp_kernel.picture(
            self.photo,
            field.flow,
            field.occlusion,
            field.corners,
            pixels(logits),
            self.generator.skips,
            made,
            frames,
        )
        flow, occlusion = torch.from_numpy(field.flow), torch.from_numpy(field.occlusion)
        return Parts(flow, occlusion[:, None], torch.from_numpy(made), frames)
