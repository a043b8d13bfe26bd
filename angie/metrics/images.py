"""Frames against recorded frames: AED, AKD, MKR, flicker.

L1, perceptual distance, SSIM and PSNR are in `mraa.perceptual`. The networks behind embeddings
and key points are arguments: the ones trained here (`identity`, the region estimator), or any
other whose results are stored in an .npz file.

A small network that tells the training set's people and clips apart, for AED.

The published score uses a person re-identification network that cannot be shipped. This one is
trained on the evaluated data itself with a triplet loss; its values can be compared only under one
hash of its weights, and never with published ones.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor, nn

from angie.metrics.score import Score
from data_prep.arrays import read_arrays
from data_prep.errors import BadInput


def aed(real: Sequence[NDArray], made: Sequence[NDArray]) -> Score:
    """Average "Euclidean" distance of identity embeddings (FOMM and MRAA): mean |e - e'|.

    The tool of those papers takes the mean absolute difference, whatever the name says.

    Args:
        real: (T, E) embeddings of the frames of each recorded clip.
        made: of the same shapes.
    """
    if any(a.shape != b.shape for a, b in zip(real, made, strict=True)):
        raise ValueError("recorded and generated embeddings must have the same shapes")
    apart = [np.abs(a.astype(np.float64) - b).mean(1) for a, b in zip(real, made, strict=True)]
    frames = sum(len(part) for part in apart)
    if not frames:
        return Score.missing("no frames", frames=0)
    return Score(float(np.concatenate(apart).mean()), counts={"frames": frames})


def _seen(points: NDArray) -> NDArray:
    return np.isfinite(points).all(axis=-1)


def akd(real: Sequence[NDArray], made: Sequence[NDArray]) -> Score:
    """Average key point distance (FOMM and MRAA): mean |p - p'| over points seen in both.

    Args:
        real: (T, n, D) points of the recorded frames of each clip; NaN where none was found.
        made: of the same shapes.
    """
    total, count, unseen = 0.0, 0, 0
    for a, b in zip(real, made, strict=True):
        both = _seen(a) & _seen(b)
        total += float(np.abs(a[both].astype(np.float64) - b[both]).sum())
        count += int(both.sum()) * a.shape[-1]
        unseen += int((~both).sum())
    if not count:
        return Score.missing("no key point is seen in both", points=0, unseen=unseen)
    return Score(total / count, counts={"numbers": count, "unseen": unseen})


def mkr(real: Sequence[NDArray], made: Sequence[NDArray]) -> Score:
    """Missing key point rate (FOMM and MRAA): share of points seen only in the truth, 0 to 1.

    Args:
        real: (T, n, D) points of the recorded frames of each clip; NaN where none was found.
        made: of the same shapes.
    """
    there = sum(int(_seen(a).sum()) for a in real)
    if not there:
        return Score.missing("no key point is seen in the truth", points=0)
    lost = sum(int((_seen(a) & ~_seen(b)).sum()) for a, b in zip(real, made, strict=True))
    return Score(lost / there, counts={"points": there, "missing": lost})


def flicker(real: NDArray, made: NDArray) -> float:
    """Mean |dI_t - dI'_t| of frames (T, H, W, 3) in [0, 1], T above 1, d from frame to frame.

    0 also for a clip that is off by a constant picture: it measures nothing but flicker.
    """
    return float(np.abs(np.diff(real, axis=0) - np.diff(made, axis=0)).mean())


def read_pair(path: Path, name: str) -> tuple[NDArray, NDArray] | None:
    """Arrays `real_<name>` and `made_<name>` of an .npz file, of another network or detector.

    Args:
        path: the file.
        name: "embeddings" (T, E), or "points" (T, n, 2) in pixels, NaN where none was found.

    Returns:
        the arrays of the recorded and of the generated frames, cut to the shorter; None where the
        file has neither.

    Raises:
        BadInput: unreadable, only one of the two, not floats, of different shapes, or embeddings
            that are not finite.
    """
    names = [f"{side}_{name}" for side in ("real", "made")]
    try:
        arrays = read_arrays(path, names)
    except ValueError as error:
        raise BadInput(f"{path}: is not a readable .npz file ({error})") from error
    found = [arrays[name] for name in names if name in arrays]
    if not found:
        return None
    if len(found) == 1:
        raise BadInput(f"{path}: has only one of {names[0]} and {names[1]}; both are needed")
    rank = 2 if name == "embeddings" else 3
    real, made = found
    if {real.ndim, made.ndim} != {rank} or real.shape[1:] != made.shape[1:]:
        raise BadInput(f"{path}: {name} have shapes {real.shape} and {made.shape}")
    if not all(np.issubdtype(values.dtype, np.floating) for values in found):
        raise BadInput(f"{path}: {name} must be floating-point numbers")
    if name == "embeddings" and not all(np.isfinite(values).all() for values in found):
        raise BadInput(f"{path}: {name} must be finite numbers")
    frames = min(len(real), len(made))
    return real[:frames], made[:frames]


SIZE = 64
"""Height and width of the pictures that the network sees."""


EMBEDDING = 64
"""Numbers of an embedding."""


class IdentityNetwork(nn.Module):
    """Pictures to embeddings of unit length: four strided convolutions and a linear layer."""

    def __init__(self) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        channels = 3
        for width in (16, 32, 64, 128):
            layers += [nn.Conv2d(channels, width, 3, 2, 1), nn.BatchNorm2d(width), nn.ReLU()]
            channels = width
        self.layers = nn.Sequential(*layers, nn.Flatten(), nn.Linear(16 * channels, EMBEDDING))

    def forward(self, pictures: Tensor) -> Tensor:
        """Embeddings (B, 64) of pictures (B, 3, H, W) in [0, 1], any size above 64."""
        if pictures.shape[2:] != (SIZE, SIZE):
            pictures = F.interpolate(pictures, size=(SIZE, SIZE), mode="area")
        return F.normalize(self.layers(pictures - 0.5), dim=1)


@dataclass(frozen=True)
class IdentityTraining:
    """How the identity network is trained.

    Attributes:
        steps: of Adam.
        clips: of a batch, two pictures each.
        rate: of Adam.
        margin: by which another clip must be farther away, in squared distance.
    """

    steps: int = 300
    clips: int = 16
    rate: float = 1e-3
    margin: float = 0.2


def triplet_loss(embeddings: Tensor, margin: float) -> Tensor:
    """Mean over anchors of the hardest triplet: `relu(d(a, p) - min_n d(a, n) + margin)`.

    Args:
        embeddings: (2, C, E) of two pictures of each of C clips, C above 1.
        margin: in squared Euclidean distance d.
    """
    one, two = embeddings
    apart = torch.cdist(one, two).square()  # (C, C)
    own = apart.diagonal()
    others = apart + torch.eye(len(apart), device=apart.device) * 1e4
    forward = F.relu(own - others.amin(1) + margin)
    backward = F.relu(own - others.amin(0) + margin)
    return (forward + backward).mean() / 2


def train_identity(
    clips: Sequence[NDArray], training: IdentityTraining | None = None, seed: int = 0
) -> IdentityNetwork:
    """Train the network on clips of people; in eval mode afterwards.

    `clips`: pictures (n, H, W, 3) uint8 of each clip, n above 1; two clips or more. `seed`: of
    weights and batches; torch's global state is left as it was.

    Raises:
        ValueError: fewer than two clips.
    """
    if len(clips) < 2 or min(len(clip) for clip in clips) < 2:
        raise ValueError("the identity network needs two clips of two pictures")
    training = training or IdentityTraining()
    rng = np.random.default_rng(seed)
    small = [_shrink(clip) for clip in clips]
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        model = IdentityNetwork().train()
        optimizer = torch.optim.Adam(model.parameters(), training.rate)
        for _ in range(training.steps):
            chosen = rng.permutation(len(small))[: training.clips]
            pairs = [small[i][rng.permutation(len(small[i]))[:2]] for i in chosen]
            batch = torch.stack(pairs, dim=1)  # (2, C, 3, h, w)
            embeddings = model(batch.flatten(0, 1)).unflatten(0, (2, len(chosen)))
            loss = triplet_loss(embeddings, training.margin)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
    return model.eval().requires_grad_(False)


def _shrink(pictures: NDArray) -> Tensor:
    data = torch.from_numpy(np.ascontiguousarray(pictures)).permute(0, 3, 1, 2).float() / 255
    return F.interpolate(data, size=(SIZE, SIZE), mode="area")


@torch.no_grad()
def embed(model: IdentityNetwork, pictures: NDArray) -> NDArray:
    """Embeddings (T, 64) float32 of pictures (T, H, W, 3) uint8."""
    parts = [model(_shrink(pictures[i : i + 64])) for i in range(0, len(pictures), 64)]
    return torch.cat(parts).numpy() if parts else np.zeros((0, EMBEDDING), np.float32)
