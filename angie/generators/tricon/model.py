"""TriCon's networks (TOG 2020): encoders of sound, words and identity; gestures; the critic.

Windows have 34 frames at 15 a second, of which the first 4 are given, and 36,267 samples of sound.
"""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.functional import interpolate
from torch.nn.utils.parametrizations import weight_norm

from angie.generators.tricon.poses import Poses
from angie.generators.tricon.words import HashedWords, KnownWords
from data_prep.rates import SAMPLE_RATE

CONTEXTS = ("both", "sound", "words", "none")
"""What a model hears: sound and words, one of them, or nothing."""

ENCODERS = ("hash", "vectors")
"""What words are: hashed parts, or vectors of a file."""

CONTEXT = 32
"""Numbers a frame of what is heard, and of what is said."""

SLOPE = 0.3
"""Of the sound encoder's leaky rectifiers below 0; of others 0.2."""


@dataclass(frozen=True)
class TriConConfig:
    """Sizes of the networks; the defaults are the paper's.

    Attributes:
        points: regions, or points without extent.
        extent: whether they are regions, with Cholesky factors.
        axes: coordinates of a point, 2 or 3; of regions 2.
        pose: "tree" of offsets, "displacement" from the rest pose, "directions" of bones; "auto" is
            the tree for regions, directions for points.
        bones: parent of each point, -1 for the root; none is a tree found in the data.
        fps: frames a second that the model works at.
        frames: of a window.
        seeds: of them that are given, the first ones.
        context: see `CONTEXTS`.
        identity: whether there is a style space.
        style: numbers of a style; the released code has 16.
        width: of the recurrent network.
        layers: of it.
        dropout: of it, and of the text network.
        linear_head: leave the rectifier before the last layer out, as the released code does.
        encoder: of words, see `ENCODERS`.
        buckets: rows that hashed parts of words share.
        word_width: numbers of a word's vector, and width of the text network.
    """

    points: int = 20
    extent: bool = True
    axes: int = 2
    pose: str = "auto"
    bones: tuple[int, ...] = ()
    fps: int = 15
    frames: int = 34
    seeds: int = 4
    context: str = "both"
    identity: bool = True
    style: int = 8
    width: int = 300
    layers: int = 4
    dropout: float = 0.3
    linear_head: bool = False
    encoder: str = "hash"
    buckets: int = 50_000
    word_width: int = 300

    def __post_init__(self) -> None:
        if self.context not in CONTEXTS or self.encoder not in ENCODERS:
            raise ValueError(f"context is one of {CONTEXTS}, encoder one of {ENCODERS}")
        if not 1 <= self.seeds < self.frames - 7 or not 1 <= self.fps <= 60:
            raise ValueError("frames are at least 8 more than seeds, fps from 1 to 60")
        if min(self.style, self.width // 2, self.layers, self.buckets, self.word_width) < 1:
            raise ValueError("widths, layers and buckets must be positive")
        if self.axes not in (2, 3) or (self.extent and self.axes != 2):
            raise ValueError("axes: regions have 2, points 2 or 3")
        Poses(self.points, self.extent, self.pose, self.axes)

    @property
    def samples(self) -> int:
        """Samples of a window's sound."""
        return round(self.frames * SAMPLE_RATE / self.fps)

    @property
    def hears(self) -> bool:
        """Whether sound is heard."""
        return self.context in ("both", "sound")

    @property
    def reads(self) -> bool:
        """Whether words are read."""
        return self.context in ("both", "words")


class SoundEncoder(nn.Module):
    """Raw sound (B, N) to (B, T, 32): four convolutions of 15, strides 5, 6, 6, 6."""

    def __init__(self) -> None:
        super().__init__()
        widths, layers = (1, 16, 32, 64), list[nn.Module]()
        for i, width in enumerate(widths[1:]):
            stride, pad = (5, 1600) if i == 0 else (6, 0)
            layers += [nn.Conv1d(widths[i], width, 15, stride, pad), nn.BatchNorm1d(width)]
            layers.append(nn.LeakyReLU(SLOPE))
        self.layers = nn.Sequential(*layers, nn.Conv1d(64, CONTEXT, 15, 6))

    def forward(self, sound: Tensor, frames: int) -> Tensor:
        """Features (B, T, 32) of `frames` frames; 36,267 samples give 34 without interpolation."""
        heard = self.layers(sound[:, None])
        if heard.shape[-1] != frames:
            heard = interpolate(heard, frames, mode="linear", align_corners=False)
        return heard.mT


class Causal(nn.Module):
    """Two causal convolutions of 2 with weight norm, and what came in added."""

    def __init__(self, width: int, dilation: int, dropout: float) -> None:
        super().__init__()
        self.layers = nn.Sequential()
        for _ in range(2):
            conv = nn.Conv1d(width, width, 2, dilation=dilation)
            nn.init.normal_(conv.weight, 0, 0.01)
            self.layers.extend([
                nn.ConstantPad1d((dilation, 0), 0.0), weight_norm(conv), nn.ReLU(),
                nn.Dropout(dropout),
            ])  # fmt: skip

    def forward(self, x: Tensor) -> Tensor:
        """(B, E, T) of the frames up to each."""
        return (self.layers(x) + x).relu()


class TextEncoder(nn.Module):
    """Vectors of words (B, T, E) to (B, T, 32): a temporal convolutional network, causal."""

    def __init__(self, width: int, dropout: float) -> None:
        super().__init__()
        self.drop = nn.Dropout(0.1)
        self.blocks = nn.Sequential(*(Causal(width, 2**i, dropout) for i in range(4)))
        self.out = nn.Linear(width, CONTEXT)
        nn.init.normal_(self.out.weight, 0, 0.01)
        nn.init.zeros_(self.out.bias)

    def forward(self, vectors: Tensor) -> Tensor:
        """(B, T, 32) of the words up to each frame."""
        return self.out(self.blocks(self.drop(vectors).mT).mT)


class StyleSpace(nn.Module):
    """A Gaussian (mean and log variance) in the style space for every speaker."""

    def __init__(self, speakers: int, size: int) -> None:
        super().__init__()
        self.speaker = nn.Sequential(nn.Embedding(speakers, size), nn.Linear(size, size))
        self.mean = nn.Linear(size, size)
        self.log_variance = nn.Linear(size, size)

    def forward(self, speaker: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log variance (B, Z) of speakers (B,)."""
        who = self.speaker(speaker)
        return self.mean(who), self.log_variance(who)


class Made(NamedTuple):
    """What the network makes in training.

    Attributes:
        pose: (B, T, D) gestures.
        style: (B, Z) drawn; of width 0 without identity.
        mean: (B, Z) of the speaker's Gaussian.
        log_variance: (B, Z) of it.
        other_pose: (B, T, D) gestures in the other speaker's style, without gradients.
        other_style: (B, Z) of it, likewise.
    """

    pose: Tensor
    style: Tensor
    mean: Tensor
    log_variance: Tensor
    other_pose: Tensor
    other_style: Tensor


class TriCon(nn.Module):
    """Gestures of sound, words and a style, begun with poses.

    Args:
        config: sizes.
        speakers: how many have a style.
        words: the encoder of words; None makes that of hashed parts.
    """

    def __init__(
        self, config: TriConConfig, speakers: int = 1, words: HashedWords | KnownWords | None = None
    ) -> None:
        super().__init__()
        self.config = config
        self.poses = Poses(config.points, config.extent, config.pose, config.axes)
        size, style = self.poses.size, config.style if config.identity else 0
        inputs = size + 1 + style
        if config.hears:
            self.sound = SoundEncoder()
            inputs += CONTEXT
        if config.reads:
            self.words = words or HashedWords(config.buckets, config.word_width)
            self.text = TextEncoder(self.words.weight.shape[1], config.dropout)
            inputs += CONTEXT
        if config.identity:
            self.styles = StyleSpace(speakers, style)
        self.memory = recurrent(inputs, config.width, config.layers, config.dropout)
        bend = nn.Identity() if config.linear_head else nn.LeakyReLU(0.2)
        half = config.width // 2
        self.out = nn.Sequential(nn.Linear(config.width, half), bend, nn.Linear(half, size))

    def context(self, sound: Tensor, words: Tensor, rows: Tensor) -> list[Tensor]:
        """What is heard and read, (B, T, 32) each.

        Args:
            sound: (B, N) samples.
            words: (B, T) which word begins in each frame, 0 for none.
            rows: (1 + V, M) of the words, as the encoder of words gives them.
        """
        frames = words.shape[1]
        heard = [self.sound(sound, frames)] if self.config.hears else []
        read = [self.text(self.words(words, rows))] if self.config.reads else []
        return heard + read

    def gesture(self, seeds: Tensor, context: list[Tensor], style: Tensor) -> Tensor:
        """Poses (B, T, D).

        Args:
            seeds: (B, T, D + 1), see `seeded`.
            context: see `context`.
            style: (B, Z); Z is 0 without identity.
        """
        constant = style[:, None].expand(-1, seeds.shape[1], -1)
        both, _ = self.memory(torch.cat([*context, constant, seeds], dim=-1))
        return self.out(summed(both))

    def draw(self, mean: Tensor, log_variance: Tensor) -> Tensor:
        """A style of each Gaussian (B, Z)."""
        return mean + (0.5 * log_variance).exp() * torch.randn_like(mean)

    def forward(
        self, seeds: Tensor, sound: Tensor, words: Tensor, rows: Tensor, speaker: Tensor,
        other: Tensor,
    ) -> Made:  # fmt: skip
        """Gestures in the style of `speaker` (B,), and in that of `other` (B,)."""
        context = self.context(sound, words, rows)
        if not self.config.identity:
            none = seeds.new_zeros(len(seeds), 0)
            pose = self.gesture(seeds, context, none)
            return Made(pose, none, none, none, pose.detach(), none)
        mean, log_variance = self.styles(speaker)
        style = self.draw(mean, log_variance)
        pose = self.gesture(seeds, context, style)
        with torch.no_grad():
            other_style = self.draw(*self.styles(other))
            other_pose = self.gesture(seeds, context, other_style)
        return Made(pose, style, mean, log_variance, other_pose, other_style)


class Critic(nn.Module):
    """Probability (B,) that poses (B, T, D) are recorded ones; it hears and reads nothing.

    Convolutions D -> 16 -> 8 -> 8 of 3 without padding, a recurrent network of 4 layers of 64 in
    both directions, a number of each of the T - 6 steps, and one of all.
    """

    def __init__(self, size: int, frames: int) -> None:
        super().__init__()
        self.convolutions = nn.Sequential(
            nn.Conv1d(size, 16, 3), nn.BatchNorm1d(16), nn.LeakyReLU(0.2),
            nn.Conv1d(16, 8, 3), nn.BatchNorm1d(8), nn.LeakyReLU(0.2), nn.Conv1d(8, 8, 3),
        )  # fmt: skip
        self.memory = recurrent(8, 64, 4, 0.3)
        self.step, self.all = nn.Linear(64, 1), nn.Linear(frames - 6, 1)

    def forward(self, pose: Tensor) -> Tensor:
        """Probabilities (B,)."""
        both, _ = self.memory(self.convolutions(pose.mT).mT)
        return self.all(self.step(summed(both))[..., 0])[..., 0].sigmoid()


def recurrent(inputs: int, width: int, layers: int, dropout: float) -> nn.GRU:
    """A bidirectional GRU of (B, T, inputs)."""
    dropped = dropout if layers > 1 else 0.0
    return nn.GRU(inputs, width, layers, batch_first=True, dropout=dropped, bidirectional=True)


def summed(both: Tensor) -> Tensor:
    """Both directions (..., 2 W) of a recurrent network added up, (..., W)."""
    forward, backward = both.chunk(2, dim=-1)
    return forward + backward


def seeded(given: Tensor, frames: int) -> Tensor:
    """Seed poses (B, n, D), n up to T, as the network takes them: (B, T, D + 1).

    The last channel is 1 where a pose is given; the frames that are not are 0.
    """
    marked = torch.cat([given, torch.ones_like(given[..., :1])], dim=-1)
    return nn.functional.pad(marked, (0, 0, 0, frames - given.shape[1]))
