"""The motion refiner: rhythmic residuals on top of the common patterns, from MFCC windows.

ANGIE (NeurIPS 2022), section 3.3, equation 10: bidirectional LSTMs see the pattern motion and the
sound and predict residuals of shift and Cholesky factor, M = pattern + residual. The paper feeds
absolute poses (`RefinerConfig.sees="pose"`); "displacement" takes the first frame's away.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from angie.motion.windows import WINDOW, cross_fade
from data_prep.speech.features import MFCC_COLUMNS, MFCC_ROWS

SEES = ("displacement", "pose")


@dataclass(frozen=True)
class RefinerConfig:
    """Architecture of the refiner; the paper does not state sizes.

    Attributes:
        regions: K.
        sound: channels of the MFCC frame encoder.
        motion: channels of the motion embedding.
        hidden: of the LSTM, per direction.
        layers: of the LSTM.
        dropout: between LSTM layers.
        streams: 2 are shift and Cholesky factor, 1 is shift alone (keypoints).
        sees: of the pattern: the "displacement" from a window's first frame, for which the place
            of the person does not matter, or the "pose" itself, as in the paper, less the
            training set's mean pose.
    """

    regions: int = 20
    sound: int = 256
    motion: int = 128
    hidden: int = 256
    layers: int = 2
    dropout: float = 0.1
    streams: int = 2
    sees: str = "displacement"

    def __post_init__(self) -> None:
        if self.sees not in SEES:
            raise ValueError(f"sees is one of {', '.join(SEES)}, not {self.sees!r}")
        if self.streams not in (1, 2):
            raise ValueError(f"there are 1 or 2 streams of motion, not {self.streams}")
        if min(self.regions, self.sound, self.motion, self.hidden, self.layers) < 1:
            raise ValueError("regions, sound, motion, hidden and layers must be positive")
        if not 0 <= self.dropout < 1:
            raise ValueError(f"dropout lies between 0 and 1, not {self.dropout:g}")

    @property
    def channels(self) -> list[int]:
        """Channels of each stream."""
        return [2 * self.regions, 3 * self.regions][: self.streams]


class StreamRefiner(nn.Module):
    """Residuals of one stream of C channels."""

    def __init__(self, channels: int, config: RefinerConfig) -> None:
        super().__init__()
        self.sound = nn.Sequential(
            nn.Linear(MFCC_ROWS * MFCC_COLUMNS, config.sound),
            nn.LayerNorm(config.sound),
            nn.GELU(),
            nn.Linear(config.sound, config.sound),
        )
        self.motion = nn.Linear(channels, config.motion)
        self.lstm = nn.LSTM(
            config.sound + config.motion,
            config.hidden,
            config.layers,
            batch_first=True,
            bidirectional=True,
            dropout=config.dropout if config.layers > 1 else 0.0,
        )
        self.out = nn.Linear(2 * config.hidden, channels)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)

    def forward(self, mfcc: Tensor, motion: Tensor) -> Tensor:
        """MFCC windows (B, T, 28, 12), pattern motion (B, T, C) to residuals (B, T, C)."""
        batch, frames = mfcc.shape[:2]
        sound = self.sound(mfcc.flatten(-2).flatten(0, 1)).unflatten(0, (batch, frames))
        seen = torch.cat([sound, self.motion(motion)], dim=-1)
        hidden, _ = self.lstm(seen)
        return self.out(hidden)


class Refiner(nn.Module):
    """Residual motion from sound and pattern motion; exactly zero before training.

    Poses and residuals are in units of the training displacement's standard deviation.
    """

    mean: Tensor

    def __init__(self, config: RefinerConfig) -> None:
        super().__init__()
        self.config = config
        self.shift = StreamRefiner(2 * config.regions, config)
        if config.streams > 1:
            self.cholesky = StreamRefiner(3 * config.regions, config)
        if config.sees == "pose":  # mean training pose in units of the pose scale
            self.register_buffer("mean", torch.zeros(sum(config.channels)))

    @property
    def streams(self) -> list[StreamRefiner]:
        """Of shift and, if there is one, of the Cholesky factor."""
        return [self.shift, self.cholesky] if self.config.streams > 1 else [self.shift]

    def forward(self, mfcc: Tensor, pattern: Tensor) -> Tensor:
        """Residuals of a window.

        Args:
            mfcc: (B, T, 28, 12) standardised.
            pattern: (B, T, 5K) absolute pattern motion in units of the pose scale.

        Returns:
            (B, T, 5K) residuals in units of the pose scale.
        """
        origin = self.mean if self.config.sees == "pose" else pattern[:, :1]
        seen = (pattern - origin).split(self.config.channels, dim=-1)
        parts = zip(self.streams, seen, strict=True)
        return torch.cat([stream(mfcc, part) for stream, part in parts], dim=-1)

    @torch.no_grad()
    def refine(
        self,
        mfcc: Tensor,
        pattern: Tensor,
        standard: Callable[[Tensor], Tensor] = lambda mfcc: mfcc,
        blend: str = "linear",
    ) -> Tensor:
        """Residuals of a sequence of any length, in overlapping windows of 96 frames.

        The LSTMs start anew in each window, as in training.

        Args:
            mfcc: (T, 28, 12).
            pattern: (T, 5K) in units of the pose scale.
            standard: standardises MFCC windows (n, 96, 28, 12), a few at a time.
            blend: how residuals of windows become those of all, see `angie.motion.windows.BLENDS`.

        Returns:
            (T, 5K) residuals in units of the pose scale, on the CPU.
        """
        device = self.shift.out.weight.device
        frames = len(pattern)

        def compute(starts: list[int], size: int = WINDOW) -> Tensor:
            sound = torch.stack([mfcc[at : at + size] for at in starts])
            motion = torch.stack([pattern[at : at + size] for at in starts])
            return self(standard(sound.to(device)), motion.to(device))

        return cross_fade(frames, WINDOW, compute, blend)
