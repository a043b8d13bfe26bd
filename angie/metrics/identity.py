"""A small network that tells the training set's people and clips apart, for AED.

The published score uses a person re-identification network that cannot be shipped. This one is
trained on the evaluated data itself with a triplet loss; its values can be compared only under one
hash of its weights, and never with published ones.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor, nn

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

    Args:
        clips: pictures (n, H, W, 3) uint8 of each clip, n above 1; two clips or more.
        training: how.
        seed: of weights and batches; torch's global state is left as it was.

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
