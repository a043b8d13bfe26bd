"""A renderer opened on one photo, for inference on a CPU: folded, packed, channels last, one type.

The image generators compute what `mraa.generator` computes for one source and B poses, up to the
logits of the generated picture. Tensors are (B, C, H, W) with channels last in memory.
"""

from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from mraa.blocks import ResBlock
from mraa.fast import warp_kernel
from mraa.fast.convolution import Convolution, same_convolution
from mraa.fast.flow import Field, FoldedFlow, Shape, empty, framed, pixels, planes, up_convolution
from mraa.fast.folding import blocks, fold, norm_scale_shift
from mraa.fast.winograd import Winograd, joined, split
from mraa.generator import DeepGenerator, ImageGenerator, LiteGenerator
from mraa.regions import Regions
from mraa.renderer import Parts, Renderer, Source


class Features:
    """Features of the source at one size, to be warped into B frames."""

    def __init__(self, features: Tensor, dtype: torch.dtype) -> None:
        self.dtype = dtype
        self.shape = features.shape[1:]
        bits = pixels(features.to(dtype, memory_format=torch.channels_last))[0]
        self.array = framed(bits)

    def blend(
        self, field: Field, generated: Tensor | None, lie: int, *, warped: bool = True
    ) -> Tensor:
        """Warped features, blended with generated ones as `mraa.fast.warp_kernel.blend` does."""
        out = empty((len(field.flow), *self.shape), self.dtype)
        made = pixels(out if generated is None else generated)
        warp_kernel.blend(
            self.array, field.flow, field.occlusion, field.corners, made, lie, warped, pixels(out)
        )
        return out


class FoldedResidual:
    """A `ResBlock` or a `PostResBlock`."""

    def __init__(self, block: Any, shape: Shape, dtype: torch.dtype) -> None:
        before = isinstance(block, ResBlock)  # the first norm has no convolution before it
        scale_shift = norm_scale_shift(block.norm1) if before else None
        first = fold(block.conv1, block.norm2 if before else block.norm1)
        second = fold(block.conv2, None if before else block.norm2)
        self.first = same_convolution(first, shape, dtype=dtype, scale_shift=scale_shift)
        self.second = same_convolution(second, shape, dtype=dtype, relu=not before)
        self.in_lines = not before and isinstance(self.second, Winograd)

    def __call__(self, x: Tensor) -> Tensor:
        """(B, C, H, W) to the same shape."""
        return self.second(self.first(x), x)


class Bottleneck:
    """Residual blocks, one after the other."""

    def __init__(self, blocks: Any, shape: Shape, dtype: torch.dtype) -> None:
        self.blocks: list[Any] = [FoldedResidual(block, shape, dtype) for block in blocks]
        self.in_lines = len(self.blocks) > 0 and all(block.in_lines for block in self.blocks)

    def __call__(self, x: Tensor) -> Tensor:
        """(B, C, H, W) to the same shape."""
        if not self.in_lines:
            for block in self.blocks:
                x = block(x)
            return x
        lines = split(x)
        between, out = torch.zeros_like(lines), torch.zeros_like(lines)
        for block in self.blocks:
            block.first.convolve(lines, between, len(x))
            block.second.convolve(between, out, len(x), lines)
            lines, out = out, lines
        return joined(lines, len(x))


class FoldedPaper:
    """`mraa.generator.ImageGenerator` for one source; arguments as `fold_generator`."""

    def __init__(
        self, generator: ImageGenerator, features: list[Tensor], count: int, dtype: torch.dtype
    ) -> None:
        shapes = [(count, *f.shape[1:]) for f in features]
        self.skips = generator.skips
        self.bottleneck = Bottleneck(generator.bottleneck, shapes[-1], dtype)
        ups = zip(generator.up_blocks, reversed(shapes[1:]), strict=True)
        self.ups = [up_convolution(up, (count, *shape[2:]), dtype) for up, shape in ups]
        last = blocks(fold(generator.final))  # three channels of 7x7 use a vector badly
        self.final = Convolution(last, shapes[0], dtype=dtype, padding=3, stride=2, relu=False)
        self.features = [Features(f, dtype) for f in features]

    def __call__(self, field: Field) -> Tensor:
        """Logits of the generated picture, (B, 12, H / 2, W / 2) as a pixel shuffle reads."""
        *others, deepest = self.features
        x = self.bottleneck(deepest.blend(field, None, warp_kernel.NONE))
        if self.skips:
            x = deepest.blend(field, x, warp_kernel.SAME)
        for up, features in zip(self.ups, reversed(others), strict=True):
            x = features.blend(field, up(x), warp_kernel.PHASES, warped=self.skips)
        return self.final(x)


class FoldedLite:
    """`mraa.generator.LiteGenerator` for one source; arguments as `fold_generator`."""

    skips = True

    def __init__(
        self, generator: LiteGenerator, features: list[Tensor], count: int, dtype: torch.dtype
    ) -> None:
        half, quarter = ((count, *f.shape[1:]) for f in features)
        self.bottleneck = Bottleneck(generator.bottleneck, quarter, dtype)
        self.up = up_convolution(generator.up, (count, *quarter[2:]), dtype)
        self.final = same_convolution(fold(generator.final), half, dtype=dtype, relu=False)
        self.half, self.quarter = (Features(f, dtype) for f in features)

    def __call__(self, field: Field) -> Tensor:
        """Logits of the generated picture, (B, 12, H / 2, W / 2) as a pixel shuffle reads."""
        x = self.bottleneck(self.quarter.blend(field, None, warp_kernel.NONE))
        return self.final(self.half.blend(field, self.up(x), warp_kernel.PHASES))


class FoldedDeep:
    """`mraa.generator.DeepGenerator` for one source; arguments as `fold_generator`."""

    skips = True

    def __init__(
        self, generator: DeepGenerator, features: list[Tensor], count: int, dtype: torch.dtype
    ) -> None:
        half, quarter, eighth = ((count, *f.shape[1:]) for f in features)
        pose, down = generator.pose, generator.pose_down
        kernel = fold(pose.conv, pose.norm)
        seen = (count, kernel.weight.shape[1], *quarter[2:])
        self.pose = Convolution(kernel, seen, dtype=dtype)
        seen = (count, len(kernel.bias), *eighth[2:])
        self.pose_down = same_convolution(fold(down.conv, down.norm), seen, dtype=dtype)
        self.bottleneck = Bottleneck(generator.bottleneck, eighth, dtype)
        self.refine = Bottleneck(generator.refine, quarter, dtype)
        self.sharpen = Bottleneck(generator.sharpen, half, dtype)
        sizes = [(count, *eighth[2:]), (count, *quarter[2:])]
        ups = zip(generator.up_blocks, sizes, strict=True)
        self.ups = [up_convolution(up, at, dtype) for up, at in ups]
        self.final = same_convolution(fold(generator.final), half, dtype=dtype, relu=False)
        self.half, self.quarter, self.eighth = (Features(f, dtype) for f in features)

    def __call__(self, field: Field) -> Tensor:
        """Logits of the generated picture, (B, 12, H / 2, W / 2) as a pixel shuffle reads.

        With a fine occlusion there are 16 channels, its logits last.
        """
        size = self.quarter.shape[1:]
        seen = field.features
        if seen.shape[2:] != size:
            seen = F.interpolate(seen, size=size)
        pose = self.pose(seen)
        x = self.eighth.blend(field, None, warp_kernel.NONE)
        x = self.bottleneck(x.add_(self.pose_down(F.avg_pool2d(pose, 2))))
        x = self.quarter.blend(field, self.ups[0](x), warp_kernel.PHASES)
        x = self.refine(x.add_(pose))
        x = self.half.blend(field, self.ups[1](x), warp_kernel.PHASES)
        return self.final(self.sharpen(x))


FoldedGenerator = FoldedPaper | FoldedLite | FoldedDeep


def fold_generator(
    generator: nn.Module, features: list[Tensor], count: int, dtype: torch.dtype
) -> FoldedGenerator:
    """An image generator for one source.

    Args:
        generator: in eval mode.
        features: what its `encode` gives of the photo, highest resolution first.
        count: B, frames at once.
        dtype: of features and convolutions.
    """
    if isinstance(generator, ImageGenerator):
        return FoldedPaper(generator, features, count, dtype)
    if isinstance(generator, LiteGenerator):
        return FoldedLite(generator, features, count, dtype)
    if isinstance(generator, DeepGenerator):
        return FoldedDeep(generator, features, count, dtype)
    raise TypeError(f"no fast way to draw with a {type(generator).__name__}")


class Folded:
    """A renderer opened on one photo.

    Args:
        renderer: in eval mode.
        source: what `Renderer.open` gave.
        count: B, frames at once.
        dtype: of the convolutions.
    """

    def __init__(self, renderer: Renderer, source: Source, count: int, dtype: torch.dtype) -> None:
        self.size = source.image.shape[2:]
        self.photo = planes(source.image)
        self.flow = FoldedFlow(renderer.flow, source.small, source.regions, count, dtype)
        self.generator = fold_generator(renderer.generator, source.features, count, dtype)

    @torch.no_grad()
    def __call__(self, driving: Regions, background: Tensor, painted: bool) -> Parts:
        """Draw B frames; without `painted` the generated picture is left out (of size 0)."""
        field = self.flow(driving, background)
        logits = self.generator(field)
        count, (height, width) = len(field.flow), self.size
        made = np.empty((count, 3, height, width) if painted else (0, 3, 0, 0), np.float32)
        fine = painted and logits.shape[1] > 12
        shown = np.empty((count, height, width) if fine else (0, 0, 0), np.float32)
        frames = np.empty((count, height, width, 3), np.uint8)
        warp_kernel.picture(
            self.photo,
            field.flow,
            field.occlusion,
            field.corners,
            pixels(logits),
            self.generator.skips,
            made,
            shown,
            frames,
        )
        flow = torch.from_numpy(field.flow)
        occlusion = torch.from_numpy(shown if fine else field.occlusion)
        return Parts(flow, occlusion[:, None], torch.from_numpy(made), frames)
