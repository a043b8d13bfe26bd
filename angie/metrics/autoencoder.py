"""The auto-encoder whose 32 features FGD compares (TriCon, Yoon et al. 2020, released code).

FGD depends on it: two distances can be compared only when they come from the same weights, which
is why it is stored beside the scores and named by its hash.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError
from torch import Tensor, nn

from data_prep.errors import BadInput
from data_prep.tensors import open_tensors, save_tensors

if TYPE_CHECKING:
    from mraa.training.run import Run

FORMAT = 1
KEY = "fgd"

FEATURES = 32
"""Features of a window."""

WINDOW = 64
"""Frames of a window, L: 2.56 s at 25 frames a second (TriCon's code: 34 at 15)."""

HOP = 10
"""Frames from one window to the next."""

_SLOPE = 0.2


def windows(clips: Sequence[NDArray], frames: int = WINDOW, hop: int = HOP) -> NDArray:
    """Windows (n, L, D) of clips (T, D), n = 0 when none is long enough."""
    cut = [
        clip[first : first + frames]
        for clip in clips
        for first in range(0, len(clip) - frames + 1, hop)
    ]
    width = clips[0].shape[1] if len(clips) else 0
    return np.stack(cut) if cut else np.zeros((0, frames, width), np.float32)


class MotionAutoencoder(nn.Module):
    """Convolutional auto-encoder of windows of motion.

    Encoder: valid convolutions D -> 32 (3), 32 -> 64 (3), 64 -> 64 (4, stride 2), each with batch
    norm and leaky ReLU 0.2, 64 -> 32 (3); linear -> 256 -> 128 -> 32 with the same between; linear
    32 -> 32. Decoder: linear 32 -> 64 -> 4 L; transposed convolutions 4 -> 32 -> 32 (3),
    convolutions 32 -> 32 -> D (3).

    Args:
        channels: D, numbers of a frame.
        frames: L, frames of a window, at least 12.
    """

    def __init__(self, channels: int, frames: int = WINDOW) -> None:
        super().__init__()
        self.channels, self.frames = channels, frames
        flat = 32 * ((frames - 8) // 2 - 1)
        self.encoder = nn.Sequential(
            *_normed(nn.Conv1d(channels, 32, 3), 32),
            *_normed(nn.Conv1d(32, 64, 3), 64),
            *_normed(nn.Conv1d(64, 64, 4, stride=2), 64),
            nn.Conv1d(64, 32, 3),
            nn.Flatten(),
            *_normed(nn.Linear(flat, 256), 256),
            *_normed(nn.Linear(256, 128), 128),
            nn.Linear(128, FEATURES),
            nn.Linear(FEATURES, FEATURES),
        )
        self.decoder = nn.Sequential(
            *_normed(nn.Linear(FEATURES, 64), 64),
            nn.Linear(64, 4 * frames),
            nn.Unflatten(1, (4, frames)),
            *_normed(nn.ConvTranspose1d(4, 32, 3), 32),
            *_normed(nn.ConvTranspose1d(32, 32, 3), 32),
            nn.Conv1d(32, 32, 3),
            nn.Conv1d(32, channels, 3),
        )

    def encode(self, motion: Tensor) -> Tensor:
        """Features (B, 32) of windows (B, L, D)."""
        return self.encoder(motion.mT)

    def forward(self, motion: Tensor) -> Tensor:
        """Windows (B, L, D) as they come out of the bottleneck."""
        return self.decoder(self.encode(motion)).mT


def _normed(layer: nn.Module, channels: int) -> list[nn.Module]:
    return [layer, nn.BatchNorm1d(channels), nn.LeakyReLU(_SLOPE)]


@dataclass(frozen=True)
class AutoencoderTraining:
    """How the auto-encoder is trained; the defaults are TriCon's, but for `most_steps`.

    Attributes:
        rate: of Adam.
        betas: of Adam.
        batch: windows a step.
        epochs: passes over the windows.
        most_steps: steps after which training ends before its epochs; None for no bound.
    """

    rate: float = 5e-4
    betas: tuple[float, float] = (0.5, 0.999)
    batch: int = 128
    epochs: int = 500
    most_steps: int | None = 3000

    def steps(self, windows: int) -> int:
        """Steps of a training on so many windows."""
        steps = self.epochs * max(1, round(windows / self.batch))
        return min(steps, self.most_steps or steps)


def reconstruction_loss(made: Tensor, motion: Tensor) -> Tensor:
    """Sum over the batch of the mean L1 error and that of the frames' differences."""
    plain = (made - motion).abs().mean(dim=(1, 2))
    change = (made.diff(dim=1) - motion.diff(dim=1)).abs().mean(dim=(1, 2))
    return (plain + change).sum()


def train_autoencoder(
    motion: NDArray, run: "Run", training: AutoencoderTraining | None = None
) -> MotionAutoencoder:
    """Train the auto-encoder on standardised windows; in eval mode afterwards.

    `motion`: (n, L, D) windows of the training split, n at least 2. `run`: of `training.steps(n)`
    steps; weights and order follow from its seed.

    Raises:
        ValueError: fewer than two windows.
    """
    if len(motion) < 2:
        raise ValueError("the auto-encoder needs at least two windows")
    training = training or AutoencoderTraining()
    data = torch.from_numpy(np.asarray(motion, np.float32))
    model = MotionAutoencoder(data.shape[2], data.shape[1])
    optimizer = torch.optim.Adam(model.parameters(), training.rate, training.betas)
    learner = run.add(KEY, model, optimizer)
    batches = run.batches(data, min(training.batch, len(data)))
    for _ in run.steps():
        batch = next(batches)
        loss = reconstruction_loss(learner(batch), batch)
        run.update(loss, KEY)
        run.log(loss=loss)
    return model.eval().requires_grad_(False)


@torch.no_grad()
def encode_windows(model: MotionAutoencoder, motion: NDArray) -> NDArray:
    """Features (n, 32) float64 of windows (n, L, D)."""
    data = torch.from_numpy(np.asarray(motion, np.float32))
    parts = [model.encode(part) for part in data.split(256)] if len(data) else []
    return torch.cat(parts).double().numpy() if parts else np.zeros((0, FEATURES))


@torch.no_grad()
def explained(model: MotionAutoencoder, motion: NDArray) -> float:
    """Share of the variance of windows (n, L, D), n above 0, that the bottleneck keeps.

    1 for a perfect reconstruction; 0, or less, for one that is no better than the mean pose.
    """
    data = torch.from_numpy(np.asarray(motion, np.float32))
    error = torch.cat([(model(part) - part).square() for part in data.split(256)])
    spread = (data - data.mean(dim=(0, 1))).square().mean()
    return float(1 - error.mean() / spread.clamp_min(1e-12))


@dataclass(frozen=True)
class MotionScale:
    """How motion vectors are standardised: displacement from the speaker's rest over `scale`.

    Attributes:
        speakers: names, P of them.
        rest: (P, D) rest pose of each.
        scale: (D,) standard deviation of the displacement.
    """

    speakers: tuple[str, ...]
    rest: NDArray
    scale: NDArray

    def standard(self, motion: NDArray, speaker: str) -> NDArray:
        """Standardised motion (T, D) float32 of a speaker.

        Raises:
            BadInput: the speaker has no rest pose here.
        """
        if speaker not in self.speakers:
            known = ", ".join(self.speakers)
            raise BadInput(
                f"{speaker}: FGD needs training clips of every test speaker; known: {known}"
            )
        rest = self.rest[self.speakers.index(speaker)]
        return ((motion - rest) / self.scale).astype(np.float32)


def save_autoencoder(
    path: Path,
    model: MotionAutoencoder,
    scale: MotionScale,
    estimator: str,
    fps: float,
    training: AutoencoderTraining | None = None,
    seed: int = 0,
) -> None:
    """Write the auto-encoder with all that its features depend on, as safetensors.

    `scale`: how its motion was standardised. `estimator`: hash of the region estimator that
    measured the motion.
    """
    tensors = {f"model.{k}": v.contiguous() for k, v in model.state_dict().items()}
    tensors["rest"] = torch.from_numpy(np.ascontiguousarray(scale.rest, np.float32))
    tensors["scale"] = torch.from_numpy(np.ascontiguousarray(scale.scale, np.float32))
    about = {
        "format": FORMAT,
        "speakers": scale.speakers,
        "estimator": estimator,
        "fps": fps,
        "frames": model.frames,
        "training": {**asdict(training or AutoencoderTraining()), "seed": seed},
    }
    # one entry, because the order of several is another in every process
    save_tensors(path, tensors, {KEY: json.dumps(about, sort_keys=True)})


@dataclass(frozen=True)
class StoredAutoencoder:
    """What `save_autoencoder` wrote, with its arguments."""

    model: MotionAutoencoder
    scale: MotionScale
    estimator: str
    fps: float
    training: dict[str, Any]


def load_autoencoder(path: Path) -> StoredAutoencoder:
    """Read what `save_autoencoder` wrote.

    Raises:
        BadInput: missing, damaged, no auto-encoder, or of a newer format.
    """
    try:
        with open_tensors(path) as file:
            about = json.loads((file.metadata() or {})[KEY])
            if about["format"] != FORMAT:
                raise BadInput(f"{path}: made by a newer angie; update angie")
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        rest, scale = tensors.pop("rest").numpy(), tensors.pop("scale").numpy()
        model = MotionAutoencoder(len(scale), about["frames"])
        model.load_state_dict({k.removeprefix("model."): v for k, v in tensors.items()})
        speakers = tuple(about["speakers"])
        estimator, fps, training = about["estimator"], about["fps"], about["training"]
    except (OSError, SafetensorError, KeyError, TypeError, ValueError, RuntimeError) as error:
        what = " ".join(str(error).split())
        raise BadInput(
            f"{path}: is not an autoencoder of FGD ({what}); give one of a report"
        ) from error
    model.eval().requires_grad_(False)
    return StoredAutoencoder(model, MotionScale(speakers, rest, scale), estimator, fps, training)
