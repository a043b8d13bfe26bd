"""The renderer by PyTorch alone: norms folded, channels last, half precision, batches.

On a GPU the work of a batch is recorded as a CUDA graph; a CPU draws this way where compiled
kernels are off. Coordinates, masks and warps stay float32, as `mraa.flow` and `mraa.grid` have it.
Not measured on a GPU: none was at hand when this was written.
"""

import copy
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn

from mraa.blocks import DownBlock, PostResBlock, ResBlock, SameBlock, UpBlock
from mraa.fast.folding import fold
from mraa.flow import Flow
from mraa.generator import DeepGenerator
from mraa.regions import Regions
from mraa.renderer import Parts, Renderer, Source, to_pixels

_WARM_UP = 3
"""Calls before a CUDA graph is recorded, in which libraries choose their kernels."""


def fold_norms(module: nn.Module) -> None:
    """Fold every batch norm that follows a convolution into it, in place."""
    for block in module.modules():
        if isinstance(block, DownBlock | UpBlock | SameBlock):
            _fold_into(block, "conv", "norm")
        elif isinstance(block, ResBlock):
            _fold_into(block, "conv1", "norm2")
        elif isinstance(block, PostResBlock):
            _fold_into(block, "conv1", "norm1")
            _fold_into(block, "conv2", "norm2")


def _fold_into(block: nn.Module, conv: str, norm: str) -> None:
    layer: Any = block.get_submodule(conv)
    batch_norm: Any = block.get_submodule(norm)
    kernel = fold(layer, batch_norm)
    layer.weight.data.copy_(kernel.weight)
    layer.bias.data.copy_(kernel.bias)
    setattr(block, norm, nn.Identity())


class Accelerated:
    """A renderer opened on one photo.

    Args:
        renderer: in eval mode; copied.
        source: what `Renderer.open` gave.
        count: B, frames at once.
        dtype: of the convolutions.
    """

    def __init__(self, renderer: Renderer, source: Source, count: int, dtype: torch.dtype) -> None:
        device = source.image.device
        renderer = copy.deepcopy(renderer).requires_grad_(False)
        fold_norms(renderer)
        flow = renderer.flow
        for part in (flow.hourglass, flow.mask, flow.occlusion, renderer.generator):
            part.to(dtype).to(memory_format=torch.channels_last)
        self.renderer, self.dtype, self.count = renderer, dtype, count
        self.small = source.small.expand(count, -1, -1, -1)
        self.photo = source.image.expand(count, -1, -1, -1)
        layout = torch.channels_last
        features = [f.to(dtype, memory_format=layout) for f in source.features]
        self.features = [f.expand(count, -1, -1, -1) for f in features]
        regions = source.regions
        self.shift, self.covariance, self.affine = (
            x.expand(count, *x.shape[1:]).clone()
            for x in (regions.shift, regions.covariance, regions.affine)
        )
        self.source = Regions(regions.shift, regions.covariance, regions.affine)
        self.background = torch.eye(3, device=device).repeat(count, 1, 1)
        self.replay: Callable[[], None] | None = None
        if device.type == "cuda":
            self._record()

    def _record(self) -> None:
        """Record the work of a batch as a CUDA graph, which is then played for every batch."""
        stream = torch.cuda.Stream()
        stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(stream):
            for _ in range(_WARM_UP):
                self._compute()
        torch.cuda.current_stream().wait_stream(stream)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            self.result = self._compute()
        self.replay = graph.replay

    def _compute(self) -> tuple[Flow, Tensor, Tensor, Tensor]:
        """Flow, occlusion, generated picture and frames (B, H, W, 3) uint8 of the set poses."""
        driving = Regions(self.shift, self.covariance, self.affine)
        source = Regions(
            *(
                x.expand(self.count, *x.shape[1:])
                for x in (self.source.shift, self.source.covariance, self.source.affine)
            )
        )
        half = self.dtype != torch.float32
        generator = self.renderer.generator
        kind = self.small.device.type
        with torch.autocast(kind, self.dtype if half else None, half, cache_enabled=False):
            flow = self.renderer.flow.from_small(self.small, source, driving, self.background)
            painted = generator.paint(self.features, flow)
            frames = generator.blend(self.photo, painted, flow)
            shown = flow.occlusion
            if isinstance(generator, DeepGenerator):
                shown = generator.shown(painted, flow)
        return flow, shown, painted[:, :3].float(), to_pixels(frames.float())

    @torch.no_grad()
    def __call__(self, driving: Regions, background: Tensor, painted: bool) -> Parts:
        """Draw B frames; without `painted` the generated picture is left out (of size 0)."""
        self.shift.copy_(driving.shift)
        self.covariance.copy_(driving.covariance)
        self.affine.copy_(driving.affine)
        self.background.copy_(background)
        if self.replay is None:
            self.result = self._compute()
        else:
            self.replay()
        flow, shown, made, frames = self.result
        return Parts(
            flow.flow.float().cpu(),
            shown.float().cpu(),
            made.cpu() if painted else made[:0].cpu(),
            frames.cpu().numpy(),
        )
