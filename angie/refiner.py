"""The motion refiner: rhythmic residuals on top of the common patterns, from MFCC windows.

ANGIE (NeurIPS 2022), section 3.4: bidirectional LSTMs see the absolute pattern motion and the
sound and predict residuals of shift and Cholesky factor, M = pattern + residual.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from angie.overlap import cross_fade
from angie.windows import WINDOW
from data_prep.features import MFCC_COLUMNS, MFCC_ROWS

HOP = WINDOW // 2
"""Long sound is refined in windows of the training length, cross-faded."""


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
    """

    regions: int = 20
    sound: int = 256
    motion: int = 128
    hidden: int = 256
    layers: int = 2
    dropout: float = 0.1


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

    def forward(self, mfcc: Tensor, displacement: Tensor) -> Tensor:
        """MFCC windows (B, T, 28, 12), displacement (B, T, C) to residuals (B, T, C)."""
        seen = torch.cat([self.sound(mfcc.flatten(-2)), self.motion(displacement)], dim=-1)
        hidden, _ = self.lstm(seen)
        return self.out(hidden)


class Refiner(nn.Module):
    """Residual motion from sound and pattern motion; exactly zero before training.

    Poses and residuals are in units of the training displacement's standard deviation.

    Args:
        config: architecture.
    """

    def __init__(self, config: RefinerConfig) -> None:
        super().__init__()
        self.config = config
        self.shift = StreamRefiner(2 * config.regions, config)
        self.cholesky = StreamRefiner(3 * config.regions, config)

    def forward(self, mfcc: Tensor, pattern: Tensor) -> Tensor:
        """Residuals of a window.

        Only the displacement from the window's first frame is seen, so that the place of the
        person does not matter.

        Args:
            mfcc: (B, T, 28, 12) standardised.
            pattern: (B, T, 5K) absolute pattern motion in units of the pose scale.

        Returns:
            (B, T, 5K) residuals in units of the pose scale.
        """
        regions = self.config.regions
        displacement = pattern - pattern[:, :1]
        shift, cholesky = displacement.split([2 * regions, 3 * regions], dim=-1)
        return torch.cat([self.shift(mfcc, shift), self.cholesky(mfcc, cholesky)], dim=-1)

    @torch.no_grad()
    def refine(
        self,
        mfcc: Tensor,
        pattern: Tensor,
        standard: Callable[[Tensor], Tensor] = lambda mfcc: mfcc,
    ) -> Tensor:
        """Residuals of a sequence of any length, in windows of 96 frames every 48.

        The LSTMs start anew in each window, as in training; residuals are cross-faded.

        Args:
            mfcc: (T, 28, 12).
            pattern: (T, 5K) in units of the pose scale.
            standard: standardises MFCC windows (n, 96, 28, 12), a few at a time.

        Returns:
            (T, 5K) residuals in units of the pose scale, on the CPU.
        """
        device = self.shift.out.weight.device
        frames = len(pattern)
        size = min(WINDOW, frames)

        def compute(starts: list[int]) -> Tensor:
            sound = torch.stack([mfcc[at : at + size] for at in starts])
            motion = torch.stack([pattern[at : at + size] for at in starts])
            return self(standard(sound.to(device)), motion.to(device))

        return cross_fade(frames, WINDOW, HOP, compute)
