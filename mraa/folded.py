"""The renderer's networks for inference on a CPU: folded, packed, channels last, one type.

They compute what `mraa.flow` and `mraa.generator` compute for one photo and B poses, with the
rewrites of `mraa.folding` and the loops of `mraa.warp_kernel`. Tensors are (B, C, H, W) with
channels last in memory, except where a docstring says otherwise.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from mraa import warp_kernel
from mraa.affine import inverse
from mraa.blocks import Hourglass, ResBlock
from mraa.convolution import Convolution, same_convolution
from mraa.flow import FlowPredictor, region_maps
from mraa.folding import blocks, columns, doubling, fold, norm_line, stacked
from mraa.generator import DeepGenerator, ImageGenerator, LiteGenerator
from mraa.parts import Parts
from mraa.regions import Regions
from mraa.renderer import Renderer, Source

Shape = tuple[int, int, int, int]


def empty(shape: Shape, dtype: torch.dtype) -> Tensor:
    """An unset tensor (B, C, H, W), channels last."""
    return torch.empty(shape, dtype=dtype, memory_format=torch.channels_last)


def pixels(x: Tensor) -> np.ndarray:
    """The memory of (B, C, H, W), channels last, as an array (B, H, W, C); bfloat16 as bits."""
    bits = x.view(torch.uint16) if x.dtype == torch.bfloat16 else x
    return bits.permute(0, 2, 3, 1).numpy()


@dataclass(frozen=True)
class Field:
    """Flow and occlusion of B frames as arrays."""

    flow: np.ndarray
    """(B, h, w, 2) float32 source coordinates (x, y) in [-1, 1]."""
    occlusion: np.ndarray
    """(B, h, w) float32 in [0, 1]."""
    corners: bool
    """Grid convention of warps and resizes."""
    features: Tensor
    """(B, C, h, w), what the flow was made of (`mraa.flow.Flow.features`)."""


class FoldedHourglass:
    """`mraa.blocks.Hourglass` for inputs of one shape."""

    def __init__(self, hourglass: Hourglass, shape: Shape, dtype: torch.dtype) -> None:
        count, channels, height, width = shape
        self.downs, self.ups = [], []
        block: Any
        for block in hourglass.encoder.down_blocks:
            kernel = fold(block.conv, block.norm)
            at = (count, channels, height, width)
            self.downs.append(same_convolution(kernel, at, dtype=dtype))
            channels, height, width = len(kernel.bias), height // 2, width // 2
        for block in hourglass.decoder.up_blocks:
            self.ups.append(up_convolution(block, (count, height, width), dtype))
            height, width = height * 2, width * 2

    def __call__(self, x: Tensor) -> Tensor:
        """(B, C, H, W) to (B, width + C, H, W)."""
        skips = []
        for down in self.downs:
            skips.append(x)
            x = F.avg_pool2d(down(x), 2)
        for up, skip in zip(self.ups, reversed(skips), strict=True):
            phases = up(x)
            count, beside, height, width = skip.shape
            x = empty((count, phases.shape[1] // 4 + beside, height, width), skip.dtype)
            warp_kernel.join(pixels(phases), pixels(skip), pixels(x))
        return x


def up_convolution(block: Any, at: tuple[int, int, int], dtype: torch.dtype) -> Convolution:
    """An `UpBlock` as one convolution to phases, for inputs of B, h, w `at`."""
    kernel = doubling(fold(block.conv, block.norm))
    shape = (at[0], kernel.weight.shape[1], *at[1:])
    return Convolution(kernel, shape, dtype=dtype, padding=1)


class FoldedFlow:
    """`mraa.flow.FlowPredictor` for one source.

    Args:
        predictor: in eval mode.
        small: (1, 3, h, w) float32, the small source.
        regions: (1, K) of the source.
        count: B, frames at once.
        dtype: of the convolutions; all else is float32.
    """

    def __init__(
        self,
        predictor: FlowPredictor,
        small: Tensor,
        regions: Regions,
        count: int,
        dtype: torch.dtype,
    ) -> None:
        height, width = small.shape[2:]
        self.shape = (count, 4 * (regions.shift.shape[1] + 1), height, width)
        self.dtype, self.corners = dtype, predictor.align_corners
        self.revert = predictor.revert_axis_swap
        self.small = warp_kernel.framed(small[0].permute(1, 2, 0).numpy())
        self.regions = regions
        self.still = np.empty((height, regions.shift.shape[1], width), np.float32)
        warp_kernel.gaussians(regions.shift[0].numpy(), _precision(regions)[0], self.still)
        self.hourglass = FoldedHourglass(predictor.hourglass, self.shape, dtype)
        features = predictor.hourglass.channels_out
        kernel = stacked(fold(predictor.mask), fold(predictor.occlusion))
        at = (count, features, height, width)
        size = kernel.weight.shape[-1]
        self.logits = Convolution(
            columns(kernel), at, dtype=dtype, padding=(size // 2, 0), relu=False
        )

    def __call__(self, driving: Regions, background: Tensor) -> Field:
        """Flow and occlusion of regions (B, K) and background homographies (B, 3, 3)."""
        matrix, offset = region_maps(self.regions, driving, revert_axis_swap=self.revert)
        maps = torch.cat([matrix, offset[..., None]], dim=-1).flatten(-2).contiguous().numpy()
        far = background.contiguous().numpy()
        seen = empty(self.shape, self.dtype)
        shift = driving.shift.contiguous().numpy()
        warp_kernel.flow_input(
            self.small,
            self.still,
            shift,
            _precision(driving),
            maps,
            far,
            self.corners,
            pixels(seen),
        )
        features = self.hourglass(seen)
        logits = self.logits(features)
        count, _, height, width = self.shape
        flow = np.empty((count, height, width, 2), np.float32)
        occlusion = np.empty((count, height, width), np.float32)
        warp_kernel.flow_result(pixels(logits), maps, far, flow, occlusion)
        return Field(flow, occlusion, self.corners, features)


def _precision(regions: Regions) -> np.ndarray:
    """Entries xx, xy, yy of the inverse covariances, (B, K, 3)."""
    return inverse(regions.covariance).flatten(-2)[..., [0, 1, 3]].contiguous().numpy()


class Features:
    """Features of the source at one size, to be warped into B frames."""

    def __init__(self, features: Tensor, dtype: torch.dtype) -> None:
        self.dtype = dtype
        self.shape = features.shape[1:]
        self.array = pixels(features.to(dtype, memory_format=torch.channels_last))[0]

    def blend(
        self, field: Field, generated: Tensor | None, lie: int, *, warped: bool = True
    ) -> Tensor:
        """Warped features, blended with generated ones as `mraa.warp_kernel.blend` does."""
        out = empty((len(field.flow), *self.shape), self.dtype)
        made = pixels(out if generated is None else generated)
        warp_kernel.blend(
            self.array,
            field.flow,
            field.occlusion,
            field.corners,
            made,
            lie,
            warped,
            pixels(out),
        )
        return out


class FoldedResidual:
    """A `ResBlock` or a `PostResBlock`."""

    def __init__(self, block: Any, shape: Shape, dtype: torch.dtype) -> None:
        before = isinstance(block, ResBlock)  # the first norm has no convolution before it
        line = norm_line(block.norm1) if before else None
        first = fold(block.conv1, block.norm2 if before else block.norm1)
        second = fold(block.conv2, None if before else block.norm2)
        self.first = same_convolution(first, shape, dtype=dtype, line=line)
        self.second = same_convolution(second, shape, dtype=dtype, relu=not before)

    def __call__(self, x: Tensor) -> Tensor:
        """(B, C, H, W) to the same shape."""
        return self.second(self.first(x), x)


class Bottleneck:
    """Residual blocks, one after the other."""

    def __init__(self, blocks: Any, shape: Shape, dtype: torch.dtype) -> None:
        self.blocks = [FoldedResidual(block, shape, dtype) for block in blocks]

    def __call__(self, x: Tensor) -> Tensor:
        """(B, C, H, W) to the same shape."""
        for block in self.blocks:
            x = block(x)
        return x


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
        sizes = [(count, *eighth[2:]), (count, *quarter[2:])]
        ups = zip(generator.up_blocks, sizes, strict=True)
        self.ups = [up_convolution(up, at, dtype) for up, at in ups]
        self.final = same_convolution(fold(generator.final), half, dtype=dtype, relu=False)
        self.half, self.quarter, self.eighth = (Features(f, dtype) for f in features)

    def __call__(self, field: Field) -> Tensor:
        """Logits of the generated picture, (B, 12, H / 2, W / 2) as a pixel shuffle reads."""
        size = self.quarter.shape[1:]
        seen = field.features
        if seen.shape[2:] != size:
            seen = F.interpolate(seen, size=size)
        pose = self.pose(seen)
        x = self.eighth.blend(field, None, warp_kernel.NONE)
        x = self.bottleneck(x.add_(self.pose_down(F.avg_pool2d(pose, 2))))
        x = self.quarter.blend(field, self.ups[0](x), warp_kernel.PHASES)
        x = self.refine(x.add_(pose))
        return self.final(self.half.blend(field, self.ups[1](x), warp_kernel.PHASES))


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
