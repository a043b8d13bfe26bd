"""Image generators: the source's features, warped by the flow and inpainted (MRAA, section 3)."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from mraa.blocks import DownBlock, PostResBlock, ResBlock, SameBlock, UpBlock
from mraa.flow import Flow
from mraa.grid import resize_flow, resize_map, warp


class _Warper:
    """Flow and occlusion resized once a resolution, shared by all warped skips of a frame."""

    def __init__(self, flow: Flow, align_corners: bool) -> None:
        self.flow, self.align_corners = flow, align_corners
        self.sizes: dict[tuple[int, int], tuple[Tensor, Tensor]] = {}

    def __call__(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """Warped features (B, C, H, W) and the occlusion (B, 1, H, W) at their size."""
        height, width = features.shape[2:]
        corners = self.align_corners
        if (height, width) not in self.sizes:
            self.sizes[height, width] = (
                resize_flow(self.flow.flow, height, width, align_corners=corners),
                resize_map(self.flow.occlusion, height, width, align_corners=corners),
            )
        flow, occlusion = self.sizes[height, width]
        return warp(features, flow, align_corners=corners), occlusion

    def blend(self, features: Tensor, generated: Tensor) -> Tensor:
        """Warped features where the source shows them, `generated` elsewhere."""
        warped, occlusion = self(features)
        return warped * occlusion + generated * (1 - occlusion)


def finer(occlusion: Tensor, logits: Tensor) -> Tensor:
    """The occlusion o with `logits` added to its own: `o / (o + (1 - o) exp(-logits))`."""
    return occlusion / (occlusion + (1 - occlusion) * torch.exp(-logits.float().clamp(-40, 40)))


class ImageGenerator(nn.Module):
    """MRAA's generator: encoder, warped bottleneck, residual blocks, decoder with warped skips.

    Args:
        width: channels of the first block.
        max_width: bound of the channels.
        down_blocks: halvings before the bottleneck.
        bottleneck_blocks: residual blocks at the bottleneck.
        skips: blend warped encoder features, and at last the warped source, into the decoder.
        align_corners: grid convention of the warps.
    """

    def __init__(
        self,
        width: int = 64,
        max_width: int = 512,
        down_blocks: int = 2,
        bottleneck_blocks: int = 6,
        skips: bool = True,
        align_corners: bool = True,
    ) -> None:
        super().__init__()
        widths = [min(max_width, width * 2**i) for i in range(down_blocks + 1)]
        pairs = list(zip(widths[:-1], widths[1:], strict=True))
        self.first = SameBlock(3, width, kernel=7)
        self.down_blocks = nn.ModuleList(DownBlock(a, b) for a, b in pairs)
        self.bottleneck = nn.Sequential(*(ResBlock(widths[-1]) for _ in range(bottleneck_blocks)))
        self.up_blocks = nn.ModuleList(UpBlock(b, a) for a, b in reversed(pairs))
        self.final = nn.Conv2d(width, 3, 7, padding=3)
        self.skips = skips
        self.align_corners = align_corners

    def encode(self, source: Tensor) -> list[Tensor]:
        """Features of the source (B, 3, H, W), full resolution first; once a photo."""
        features = [self.first(source)]
        for block in self.down_blocks:
            features.append(block(features[-1]))
        return features

    def decode(self, source: Tensor, features: list[Tensor], flow: Flow) -> Tensor:
        """A frame (B, 3, H, W) in [0, 1] from the source, its features and the flow."""
        warper = _Warper(flow, self.align_corners)
        painted = self._paint(features, warper)
        return warper.blend(source, painted) if self.skips else painted

    def paint(self, features: list[Tensor], flow: Flow) -> Tensor:
        """The generated picture (B, 3, H, W) in [0, 1], before the warped source is blended in."""
        return self._paint(features, _Warper(flow, self.align_corners))

    def blend(self, source: Tensor, painted: Tensor, flow: Flow) -> Tensor:
        """What `paint` gave with the warped source where it shows what is needed."""
        return _Warper(flow, self.align_corners).blend(source, painted) if self.skips else painted

    def _paint(self, features: list[Tensor], warper: _Warper) -> Tensor:
        warped, occlusion = warper(features[-1])
        x = self.bottleneck(warped * occlusion)
        for block, skip in zip(self.up_blocks, reversed(features[1:]), strict=True):
            x = block(warper.blend(skip, x) if self.skips else x)
        x = self.final(warper.blend(features[0], x) if self.skips else x)
        return torch.sigmoid(x.float())

    def forward(self, source: Tensor, flow: Flow) -> Tensor:
        """A frame (B, 3, H, W) in [0, 1] from the source (B, 3, H, W) and the flow."""
        return self.decode(source, self.encode(source), flow)


class LiteGenerator(nn.Module):
    """A slim generator: works at a half and a quarter of the resolution, warps the photo itself.

    Pixel unshuffle, one down block, post-activation residual blocks at a quarter, one up block
    with a warped skip, pixel shuffle; the warped photo is blended in at full resolution. No
    convolution runs at full resolution and every norm folds into the convolution before it.

    Args:
        width: channels at a quarter of the resolution (twice those at a half).
        bottleneck_blocks: residual blocks.
        align_corners: grid convention of the warps.
    """

    def __init__(
        self, width: int = 128, bottleneck_blocks: int = 6, align_corners: bool = True
    ) -> None:
        super().__init__()
        self.first = SameBlock(12, width // 2)
        self.down = DownBlock(width // 2, width)
        self.bottleneck = nn.Sequential(*(PostResBlock(width) for _ in range(bottleneck_blocks)))
        self.up = UpBlock(width, width // 2)
        self.final = nn.Conv2d(width // 2, 12, 3, padding=1)
        self.align_corners = align_corners

    def encode(self, source: Tensor) -> list[Tensor]:
        """Features of the source (B, 3, H, W), half resolution first; once a photo."""
        half = self.first(F.pixel_unshuffle(source, 2))  # (B, width/2, H/2, W/2)
        return [half, self.down(half)]

    def decode(self, source: Tensor, features: list[Tensor], flow: Flow) -> Tensor:
        """A frame (B, 3, H, W) in [0, 1] from the source, its features and the flow."""
        warper = _Warper(flow, self.align_corners)
        return warper.blend(source, self._paint(features, warper))

    def paint(self, features: list[Tensor], flow: Flow) -> Tensor:
        """The generated picture (B, 3, H, W) in [0, 1], before the warped source is blended in."""
        return self._paint(features, _Warper(flow, self.align_corners))

    def blend(self, source: Tensor, painted: Tensor, flow: Flow) -> Tensor:
        """What `paint` gave with the warped source where it shows what is needed."""
        return _Warper(flow, self.align_corners).blend(source, painted)

    def _paint(self, features: list[Tensor], warper: _Warper) -> Tensor:
        half, quarter = features
        warped, occlusion = warper(quarter)
        x = self.up(self.bottleneck(warped * occlusion))
        x = self.final(warper.blend(half, x))
        return torch.sigmoid(F.pixel_shuffle(x.float(), 2))

    def forward(self, source: Tensor, flow: Flow) -> Tensor:
        """A frame (B, 3, H, W) in [0, 1] from the source (B, 3, H, W) and the flow."""
        return self.decode(source, self.encode(source), flow)


class DeepGenerator(nn.Module):
    """A slim generator that works mostly at an eighth of the resolution and knows the pose.

    As `LiteGenerator`, one level deeper: residual blocks at an eighth see four times the area at a
    quarter of the cost. The features of the flow predictor, which tell where the limbs of the new
    frame are, join the warped features, so that what the source does not show is painted for the
    pose at hand.

    Args:
        width: channels at an eighth of the resolution (half at a quarter, a quarter at a half).
        bottleneck_blocks: residual blocks at an eighth.
        flow_channels: channels of `Flow.features`.
        refine_blocks: residual blocks at a quarter.
        half_blocks: residual blocks at a half.
        fine_occlusion: move the occlusion's logits, pixel by pixel, before the photo is blended in;
            painted pictures then have these logits as a fourth channel.
        align_corners: grid convention of the warps.
    """

    def __init__(
        self,
        width: int = 128,
        bottleneck_blocks: int = 6,
        flow_channels: int = 116,
        refine_blocks: int = 2,
        half_blocks: int = 0,
        fine_occlusion: bool = False,
        align_corners: bool = True,
    ) -> None:
        super().__init__()
        half, quarter = width // 4, width // 2
        self.first = SameBlock(12, half)
        self.down_blocks = nn.ModuleList([DownBlock(half, quarter), DownBlock(quarter, width)])
        self.pose = SameBlock(flow_channels, quarter, kernel=1)
        self.pose_down = SameBlock(quarter, width)
        self.bottleneck = nn.Sequential(*(PostResBlock(width) for _ in range(bottleneck_blocks)))
        self.up_blocks = nn.ModuleList([UpBlock(width, quarter), UpBlock(quarter, half)])
        self.refine = nn.Sequential(*(PostResBlock(quarter) for _ in range(refine_blocks)))
        self.sharpen = nn.Sequential(*(PostResBlock(half) for _ in range(half_blocks)))
        self.final = nn.Conv2d(half, 16 if fine_occlusion else 12, 3, padding=1)
        self.fine_occlusion = fine_occlusion
        self.align_corners = align_corners

    def encode(self, source: Tensor) -> list[Tensor]:
        """Features of the source (B, 3, H, W), half resolution first; once a photo."""
        features = [self.first(F.pixel_unshuffle(source, 2))]
        for block in self.down_blocks:
            features.append(block(features[-1]))
        return features

    def decode(self, source: Tensor, features: list[Tensor], flow: Flow) -> Tensor:
        """A frame (B, 3, H, W) in [0, 1] from the source, its features and the flow."""
        warper = _Warper(flow, self.align_corners)
        return self._blend(source, self._paint(features, flow, warper), warper)

    def paint(self, features: list[Tensor], flow: Flow) -> Tensor:
        """The generated picture (B, 3, H, W) in [0, 1], before the warped source is blended in.

        With `fine_occlusion` a fourth channel has the logits that move the occlusion.
        """
        return self._paint(features, flow, _Warper(flow, self.align_corners))

    def blend(self, source: Tensor, painted: Tensor, flow: Flow) -> Tensor:
        """What `paint` gave with the warped source where it shows what is needed."""
        return self._blend(source, painted, _Warper(flow, self.align_corners))

    def shown(self, painted: Tensor, flow: Flow) -> Tensor:
        """Where the warped source is shown, (B, 1, h, w): the fine occlusion where there is one."""
        if not self.fine_occlusion:
            return flow.occlusion
        size = painted.shape[2:]
        occlusion = resize_map(flow.occlusion, *size, align_corners=self.align_corners)
        return finer(occlusion, painted[:, 3:])

    def _blend(self, source: Tensor, painted: Tensor, warper: _Warper) -> Tensor:
        if not self.fine_occlusion:
            return warper.blend(source, painted)
        warped, occlusion = warper(source)
        occlusion = finer(occlusion, painted[:, 3:])
        return warped * occlusion + painted[:, :3] * (1 - occlusion)

    def _paint(self, features: list[Tensor], flow: Flow, warper: _Warper) -> Tensor:
        half, quarter, eighth = features
        pose = self.pose(F.interpolate(flow.features, size=quarter.shape[2:]))
        warped, occlusion = warper(eighth)
        x = self.bottleneck(warped * occlusion + self.pose_down(F.avg_pool2d(pose, 2)))
        x = self.refine(warper.blend(quarter, self.up_blocks[0](x)) + pose)
        x = self.final(self.sharpen(warper.blend(half, self.up_blocks[1](x))))
        x = F.pixel_shuffle(x.float(), 2)
        if not self.fine_occlusion:
            return torch.sigmoid(x)
        return torch.cat([torch.sigmoid(x[:, :3]), x[:, 3:]], dim=1)

    def forward(self, source: Tensor, flow: Flow) -> Tensor:
        """A frame (B, 3, H, W) in [0, 1] from the source (B, 3, H, W) and the flow."""
        return self.decode(source, self.encode(source), flow)
