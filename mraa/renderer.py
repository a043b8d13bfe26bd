"""The renderer: its sizes, its parts, and one source animated by regions.

What a rendered frame is made of.
"""

import math
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor, nn

from data_prep.rates import IMAGE_SIZE
from mraa.affine import ROOTS
from mraa.avd import AvdNetwork
from mraa.flow import PARAMETERS, BackgroundPredictor, Flow, FlowPredictor
from mraa.generator import DeepGenerator, ImageGenerator, LiteGenerator
from mraa.regions import RegionEstimator, Regions

MOST_BLOCKS, WIDEST = 100, 1 << 16
"""Blocks in a row, and channels, beyond which a setting is a slip of the pen."""


@dataclass(frozen=True)
class HourglassConfig:
    """Sizes of one hourglass (or its encoder alone)."""

    width: int
    blocks: int = 5
    max_width: int = 1024

    def __post_init__(self) -> None:
        if min(self.width, self.blocks) < 1 or self.max_width < self.width:
            raise ValueError("width and blocks must be positive, max_width not below width")
        if self.blocks > MOST_BLOCKS or self.max_width > WIDEST:
            raise ValueError(f"at most {MOST_BLOCKS} blocks and a width of {WIDEST}")


@dataclass(frozen=True)
class GeneratorConfig:
    """Sizes of the image generator; `design` is "paper" (MRAA), or "lite" or "deep" (slim).

    `refine_blocks` at a quarter of the resolution, `half_blocks` at a half and `fine_occlusion`
    are settings of "deep"; see `mraa.generator.DeepGenerator`.
    """

    design: str = "paper"
    width: int = 64
    max_width: int = 512
    down_blocks: int = 2
    bottleneck_blocks: int = 6
    refine_blocks: int = 2
    half_blocks: int = 0
    fine_occlusion: bool = False

    def __post_init__(self) -> None:
        if self.design not in ("paper", "lite", "deep"):
            raise ValueError("design is paper, lite or deep")
        counts = (self.down_blocks, self.bottleneck_blocks, self.refine_blocks, self.half_blocks)
        if self.width < 1 or min(counts) < 0:
            raise ValueError("width must be positive, numbers of blocks not negative")
        if max(counts) > MOST_BLOCKS or max(self.width, self.max_width) > WIDEST:
            raise ValueError(f"at most {MOST_BLOCKS} blocks and a width of {WIDEST}")
        if self.design == "paper" and self.max_width < self.width:
            raise ValueError("max_width must not lie below width")
        if self.design == "paper" and IMAGE_SIZE % 2**self.down_blocks:
            raise ValueError(f"{self.down_blocks} down_blocks halve {IMAGE_SIZE} pixels too often")


@dataclass(frozen=True)
class RendererConfig:
    """Architecture of the renderer; the defaults are MRAA's at 256x256 with K = 20 (ANGIE)."""

    regions: int = 20
    estimator: HourglassConfig = field(default_factory=lambda: HourglassConfig(32))
    estimator_scale: float = 0.25
    temperature: float = 0.1
    heatmap_padding: int = 0
    background: HourglassConfig = field(default_factory=lambda: HourglassConfig(32))
    background_kind: str = "affine"
    background_scale: float = 1.0
    flow: HourglassConfig = field(default_factory=lambda: HourglassConfig(64))
    flow_scale: float = 0.25
    generator: GeneratorConfig = field(default_factory=GeneratorConfig)
    skips: bool = True
    avd_id_width: int = 64
    avd_pose_width: int = 64
    affine_mode: str = "svd"
    covariance_floor: float = 1e-4
    align_corners: bool = True
    revert_axis_swap: bool = True

    def __post_init__(self) -> None:
        modes = {"affine_mode": list(ROOTS), "background_kind": list(PARAMETERS)}
        for name, known in modes.items():
            if getattr(self, name) not in known:
                raise ValueError(f"{name} is one of {', '.join(known)}")
        if min(self.regions, self.avd_id_width, self.avd_pose_width) < 1 or self.temperature <= 0:
            raise ValueError("regions, temperature and widths of avd must be positive")
        if min(self.heatmap_padding, self.covariance_floor) < 0:
            raise ValueError("heatmap_padding and covariance_floor must not be negative")
        for name in ("estimator_scale", "flow_scale", "background_scale"):
            scale = getattr(self, name)
            if not 0 < scale <= 1 or abs(round(1 / scale) * scale - 1) > 1e-6:
                raise ValueError(f"{name} must be 1 over a whole number")
        for name in ("estimator", "flow", "background"):
            size = math.ceil(IMAGE_SIZE * getattr(self, f"{name}_scale"))
            blocks = getattr(self, name).blocks
            whole = name == "background" or size % 2**blocks == 0  # an encoder rounds down
            if size < 2**blocks or not whole:
                raise ValueError(f"{blocks} {name}.blocks halve {size} pixels too often")


@dataclass(frozen=True)
class Source:
    """What is computed once for a photo."""

    image: Tensor
    """(1, 3, H, W) in [0, 1]."""
    small: Tensor
    """(1, 3, h, w), the photo at the flow predictor's resolution."""
    features: list[Tensor]
    """The generator's encoding of the photo."""
    regions: Regions
    """Regions (1, K) of the photo."""


class Renderer(nn.Module):
    """Region estimator, background predictor, flow predictor and image generator."""

    def __init__(self, config: RendererConfig) -> None:
        super().__init__()
        self.config = config
        c, estimator, flow = config, config.estimator, config.flow
        self.estimator = RegionEstimator(
            regions=c.regions,
            width=estimator.width,
            blocks=estimator.blocks,
            max_width=estimator.max_width,
            scale=c.estimator_scale,
            temperature=c.temperature,
            padding=c.heatmap_padding,
            covariance_floor=c.covariance_floor,
            affine_mode=c.affine_mode,
        )
        self.background = BackgroundPredictor(
            kind=c.background_kind,
            width=c.background.width,
            blocks=c.background.blocks,
            max_width=c.background.max_width,
            scale=c.background_scale,
        )
        self.flow = FlowPredictor(
            regions=c.regions,
            width=flow.width,
            blocks=flow.blocks,
            max_width=flow.max_width,
            scale=c.flow_scale,
            align_corners=c.align_corners,
            revert_axis_swap=c.revert_axis_swap,
        )
        self.generator = make_generator(c)

    def forward(
        self,
        source: Tensor,
        source_regions: Regions,
        driving_regions: Regions,
        background: Tensor | None = None,
    ) -> tuple[Tensor, Flow]:
        """Frames (B, 3, H, W) in [0, 1] in the driving pose, and their flow.

        Args:
            source: images (B, 3, H, W) in [0, 1].
            source_regions: regions of `source`.
            driving_regions: regions of the frames to make.
            background: (B, 3, 3) background motion; None when the camera stands still.
        """
        flow = self.flow(source, source_regions, driving_regions, background)
        return self.generator(source, flow), flow

    def open(self, photo: Tensor, regions: Regions | None = None) -> Source:
        """Compute what is needed of a photo (1, 3, H, W) in [0, 1] once.

        Args:
            photo: the source image.
            regions: its regions (1, K), when known already.
        """
        regions = self.estimator(photo) if regions is None else regions
        return Source(photo, self.flow.down(photo), self.generator.encode(photo), regions)

    def draw(self, source: Source, driving: Regions) -> Tensor:
        """Frames (B, 3, H, W) in [0, 1] of an opened photo in the poses `driving` (B, K)."""
        count = len(driving.shift)
        flow = self.flow.from_small(
            source.small.expand(count, -1, -1, -1), source.regions.repeat(count), driving
        )
        features = [f.expand(count, -1, -1, -1) for f in source.features]
        return self.generator.decode(source.image.expand(count, -1, -1, -1), features, flow)


def to_pixels(frames: Tensor) -> Tensor:
    """(B, 3, H, W) float in [0, 1] to (B, H, W, 3) uint8."""
    return (frames.clamp(0, 1) * 255).round().to(torch.uint8).permute(0, 2, 3, 1)


def from_pixels(frames: Tensor) -> Tensor:
    """(B, H, W, 3) uint8 to (B, 3, H, W) float32 in [0, 1]."""
    return frames.permute(0, 3, 1, 2).float() / 255


def make_generator(config: RendererConfig) -> ImageGenerator | LiteGenerator | DeepGenerator:
    """The image generator that a configuration names."""
    sizes = config.generator
    if sizes.design == "deep":
        return DeepGenerator(
            width=sizes.width,
            bottleneck_blocks=sizes.bottleneck_blocks,
            flow_channels=config.flow.width + 4 * (config.regions + 1),
            refine_blocks=sizes.refine_blocks,
            half_blocks=sizes.half_blocks,
            fine_occlusion=sizes.fine_occlusion,
            align_corners=config.align_corners,
        )
    if sizes.design == "lite":
        return LiteGenerator(sizes.width, sizes.bottleneck_blocks, config.align_corners)
    return ImageGenerator(
        width=sizes.width,
        max_width=sizes.max_width,
        down_blocks=sizes.down_blocks,
        bottleneck_blocks=sizes.bottleneck_blocks,
        skips=config.skips,
        align_corners=config.align_corners,
    )


def make_avd(config: RendererConfig) -> AvdNetwork:
    """The disentanglement network that a configuration names."""
    return AvdNetwork(
        config.regions, config.avd_id_width, config.avd_pose_width, config.revert_axis_swap
    )


@dataclass(frozen=True)
class Parts:
    """What frames are made of, for those who blend the photo in at another size."""

    flow: Tensor
    """(b, h, w, 2) float32 source coordinates (x, y) in [-1, 1]."""
    occlusion: Tensor
    """(b, 1, h, w) float32 in [0, 1]; 1 where the source shows what is needed. Of the frames' size
    where the generator has a fine occlusion."""
    painted: Tensor
    """(b, 3, H, W) float32 in [0, 1], the generated picture before the photo is blended in."""
    frames: np.ndarray
    """(b, H, W, 3) uint8 RGB, the finished frames."""
