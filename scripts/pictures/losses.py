"""What a picture of a person is compared by: the whole, its hands and face, and a critic of both.

Losses are taken at the finished picture and weighted by the size of their gradients there, so that
one number says how much each term pulls, whatever its unit.
"""

import torch
import torch.nn.functional as F
from pictures.frames import Pairs
from pictures.hands import HandNetwork, hand_distance
from torch import Tensor, nn
from torch.nn.utils.parametrizations import spectral_norm

from mraa.imagenet import ImagenetDistance
from mraa.perceptual import ImagePyramid, PerceptualPyramid, bands_distance

CROP = 64
"""Pixels of the parts around hands and faces."""

CLASSES = 3
"""Kinds of parts that the critic sees: hands, faces, anything."""


def parts_of(images: Tensor, centres: Tensor) -> Tensor:
    """Parts (B * P, 3, CROP, CROP) of images (B, 3, H, W) around whole centres (B, P, 2)."""
    batch, count = centres.shape[:2]
    size = images.shape[-1]
    at = torch.arange(CROP, device=images.device) - CROP // 2
    x = centres[..., 0, None] + at  # (B, P, CROP)
    y = centres[..., 1, None] + at
    x, y = ((v + 0.5) * 2 / size - 1 for v in (x, y))
    grid = torch.stack(
        [x[:, :, None].expand(-1, -1, CROP, -1), y[..., None].expand(-1, -1, -1, CROP)], -1
    )
    grid = grid.reshape(batch, count * CROP, CROP, 2)
    found = F.grid_sample(images.float(), grid, "bilinear", "border", align_corners=False)
    found = found.view(batch, images.shape[1], count, CROP, CROP).transpose(1, 2).flatten(0, 1)
    return found.contiguous(memory_format=torch.channels_last)


def places(pairs: Pairs, random: torch.Generator) -> Tensor:
    """Whole centres (B, 5, 2) of parts that lie inside.

    Of the hands and the face (anywhere if unseen), then of where the source's hands were.
    """
    size = pairs.source.shape[-1]
    centres = pairs.centres
    anywhere = torch.rand(centres.shape, generator=random, device=centres.device) * size
    chosen = torch.where(pairs.seen[..., None], centres, anywhere)
    return torch.cat([chosen, pairs.left], 1).round().clamp(CROP // 2, size - CROP // 2)


class Critic(nn.Module):
    """Judges 64-pixel parts by what they are of; hinge loss, spectral norm, no other norm."""

    def __init__(self, width: int = 64) -> None:
        super().__init__()
        sizes = [3 + CLASSES, width, 2 * width, 4 * width]
        layers = [
            spectral_norm(nn.Conv2d(a, b, 4, 2, 1))
            for a, b in zip(sizes[:-1], sizes[1:], strict=True)
        ]
        layers.append(spectral_norm(nn.Conv2d(sizes[-1], sizes[-1], 3, 1, 1)))
        self.layers = nn.ModuleList(layers)
        self.last = spectral_norm(nn.Conv2d(sizes[-1], 1, 3, 1, 1))

    def forward(self, parts: Tensor, classes: Tensor) -> tuple[Tensor, list[Tensor]]:
        """Scores of parts (N, 3, CROP, CROP) of classes (N, CLASSES), and features."""
        planes = classes[:, :, None, None].expand(-1, -1, *parts.shape[2:])
        x = torch.cat([parts * 2 - 1, planes], 1)
        features = []
        for layer in self.layers:
            x = F.leaky_relu(layer(x), 0.2)
            features.append(x)
        return self.last(x), features


def classes_of(batch: int, device: torch.device) -> Tensor:
    """Classes (B * 6, CLASSES) of two hands, a face, two places left and one anywhere."""
    kinds = torch.tensor([0, 0, 1, 2, 2, 2], device=device)
    return F.one_hot(kinds, CLASSES).float().repeat(batch, 1)


def critic_places(chosen: Tensor, size: int, random: torch.Generator) -> Tensor:
    """Centres (B, 6, 2): those that `places` gave, and one anywhere."""
    any_place = torch.rand(len(chosen), 1, 2, generator=random, device=chosen.device)
    return torch.cat([chosen, (any_place * (size - CROP)).round() + CROP // 2], 1)


class PictureLoss(nn.Module):
    """Terms at the finished picture, each a scalar.

    Args:
        natural: distance in features of natural pictures; None to do without.
        hands: a network that sees hands; None to do without.
        width: of the random network of the multi-scale loss.
    """

    def __init__(
        self, natural: ImagenetDistance | None, hands: HandNetwork | None, width: int = 16
    ) -> None:
        super().__init__()
        self.hands = hands
        self.multi = PerceptualPyramid("random_vgg+lap", "", width, (0.5, 0.25, 0.125), 10.0)
        self.natural = natural
        self.pyramid = ImagePyramid()

    def forward(
        self, image: Tensor, truth: Tensor, centres: Tensor, hands: tuple[Tensor, Tensor, Tensor]
    ) -> dict[str, Tensor]:
        """Terms of images (B, 3, H, W) whose parts of interest lie around `centres`.

        `hands` is what `hand_distance` wants to know.
        """
        terms = {"multi": self.multi(image, truth)}
        parts, wanted = parts_of(image, centres), parts_of(truth, centres)
        terms["parts"] = bands_distance(self.pyramid(parts), self.pyramid(wanted))
        if self.natural is not None:
            terms["natural"] = self.natural(image, truth)
            large = [
                F.interpolate(x, scale_factor=2.0, mode="bilinear", align_corners=False)
                for x in (parts, wanted)
            ]
            terms["natural_parts"] = self.natural(*large)
        if self.hands is not None:
            terms["hands"] = hand_distance(self.hands, image, truth, hands)
        return terms


def critic_loss(critic: Critic, made: Tensor, true: Tensor, classes: Tensor) -> Tensor:
    """Hinge loss of the critic on made and true parts."""
    scores = critic(torch.cat([made, true]), torch.cat([classes, classes]))[0].float()
    bad, good = scores.chunk(2)
    return F.relu(1 + bad).mean() + F.relu(1 - good).mean()


def painter_terms(
    critic: Critic, made: Tensor, true: Tensor, classes: Tensor
) -> tuple[Tensor, Tensor]:
    """The hinge loss of whoever made the parts, and the distance of the critic's features."""
    with torch.no_grad():
        wanted = critic(true, classes)[1]
    scores, features = critic(made, classes)
    terms = [
        (a.float() - b.float()).abs().mean() / b.float().abs().mean().clamp_min(1e-3)
        for a, b in zip(features, wanted, strict=True)
    ]
    return -scores.float().mean(), torch.stack(terms).mean()
