"""Training pairs: two frames of one clip, augmented alike (MRAA, section 4)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
import torch
from torch import Tensor

from data_prep.dataset import Clip, Dataset, FrameStore
from data_prep.rates import IMAGE_SIZE
from mraa.losses import TPS_NUMBERS
from mraa.training.backgrounds import Screen, exchanged


@dataclass(frozen=True)
class Augmentation:
    """What is random about a pair besides which frames it holds; the defaults are MRAA's."""

    time_flip: float = 0.5
    """Probability of exchanging source and driving."""
    horizontal_flip: float = 0.5
    """Probability of mirroring both."""
    brightness: float = 0.1
    contrast: float = 0.1
    saturation: float = 0.1
    hue: float = 0.1
    """Largest relative change, and fraction of the colour circle for the hue."""
    zoom: float = 0.0
    """Not in the paper: cut both frames out alike, up to this fraction smaller, at a random
    place, so that other framings of a person are met in training."""
    background: float = 0.0
    """Not in the paper: probability of putting a person before a blue screen before another
    background, and in another light; both frames alike. Other clips stay as they are."""

    def __post_init__(self) -> None:
        colours = (self.brightness, self.contrast, self.saturation, self.hue)
        if not all(0 <= change <= 1 for change in colours):
            raise ValueError("augmentation: changes of colour lie in [0, 1]")
        chances = (self.time_flip, self.horizontal_flip, self.background)
        if not all(0 <= chance <= 1 for chance in chances):
            raise ValueError("augmentation: flips and background are probabilities in [0, 1]")


class TrainingPair(NamedTuple):
    """A pair of frames and what else is random about it; a batch of them has B in front."""

    frames: Tensor
    """(2, size, size, 3) uint8, source first."""
    tps_noise: Tensor
    """(31,) float32 standard normal, for `mraa.losses.thin_plate`."""


class FramePairs:
    """Random pairs (source, driving) of frames of one clip, in order of time.

    `clips`: those to draw from; an epoch meets each once. `size`: of the pairs in pixels, if
    smaller than the frames. `gap`: largest distance of the two frames, 0 for any (as in MRAA).
    """

    def __init__(
        self,
        dataset: Dataset,
        clips: list[Clip],
        augmentation: Augmentation,
        size: int = IMAGE_SIZE,
        gap: int = 0,
    ) -> None:
        self.dataset, self.clips, self.augmentation = dataset, clips, augmentation
        self.size, self.gap = size, gap
        self._screens: dict[str, Screen | None] = {}

    def __len__(self) -> int:
        """Number of clips."""
        return len(self.clips)

    def screen(self, clip: Clip, store: FrameStore) -> Screen | None:
        """The blue screen that a clip's person stands before, if any."""
        if clip.id not in self._screens:
            found = Screen(store[0])
            self._screens[clip.id] = found if found.there else None
        return self._screens[clip.id]

    def draw(self, index: int, random: np.random.Generator) -> TrainingPair:
        """A pair of clip `index`."""
        clip, chance = self.clips[index], self.augmentation.background
        store = self.dataset.frames(clip)
        first = int(random.integers(len(store)))
        low = max(0, first - self.gap) if self.gap else 0
        high = min(len(store), first + self.gap + 1) if self.gap else len(store)
        others = [i for i in range(low, high) if i != first] or [first]
        first, second = sorted((first, int(random.choice(others))))
        frames = [store[first], store[second]]
        screen = self.screen(clip, store) if chance else None
        if screen is not None and random.random() < chance:
            frames = list(exchanged(np.stack(frames), screen, random))
        if self.size < IMAGE_SIZE:
            small = (self.size, self.size)
            frames = [cv2.resize(f, small, interpolation=cv2.INTER_AREA) for f in frames]
        pair = torch.from_numpy(augment(np.stack(frames), self.augmentation, random))
        tps_noise = torch.from_numpy(random.standard_normal(TPS_NUMBERS, dtype=np.float32))
        return TrainingPair(pair, tps_noise)


@dataclass(frozen=True)
class Share:
    """A further dataset that a renderer is trained on.

    Attributes:
        dataset: its training clips are used.
        weight: pairs drawn of it for each one of the first dataset.
    """

    dataset: Dataset
    weight: float


class MixedPairs:
    """Pairs of several datasets, each as often as its weight says.

    Args:
        parts: of one dataset each.
        weights: of each, above 0.
    """

    def __init__(self, parts: Sequence[FramePairs], weights: Sequence[float]) -> None:
        self.parts, self.ends = list(parts), np.cumsum(weights) / np.sum(weights)

    def __len__(self) -> int:
        """Number of clips."""
        return sum(len(part) for part in self.parts)

    def draw(self, index: int, random: np.random.Generator) -> TrainingPair:
        """A pair of a random clip of a dataset that is drawn by weight; `index` does not matter."""
        part = self.parts[int(np.searchsorted(self.ends[:-1], random.random(), side="right"))]
        return part.draw(int(random.integers(len(part))), random)


def augment(pair: np.ndarray, how: Augmentation, random: np.random.Generator) -> np.ndarray:
    """Flip and jitter frames (2, H, W, 3) uint8 alike."""
    if random.random() < how.time_flip:
        pair = pair[::-1]
    if random.random() < how.horizontal_flip:
        pair = pair[:, :, ::-1]
    if how.zoom:
        pair = _zoom(pair, 1 - how.zoom * random.random(), random)
    return np.ascontiguousarray(_jitter(pair, how, random))


def _zoom(pair: np.ndarray, part: float, random: np.random.Generator) -> np.ndarray:
    size = pair.shape[1]
    side = round(part * size)
    x, y = random.integers(0, size - side + 1, size=2)
    cut = np.ascontiguousarray(pair[:, y : y + side, x : x + side])
    return np.stack([cv2.resize(f, (size, size), interpolation=cv2.INTER_LINEAR) for f in cut])


def _jitter(pair: np.ndarray, how: Augmentation, random: np.random.Generator) -> np.ndarray:
    """Brightness, contrast, saturation and hue in random order."""
    from kornia import enhance  # takes half a second, and only training needs it

    brightness, contrast, saturation = (
        float(random.uniform(1 - amount, 1 + amount))
        for amount in (how.brightness, how.contrast, how.saturation)
    )
    turn = 2 * np.pi * random.uniform(-how.hue, how.hue)
    changes = (
        (enhance.adjust_brightness_accumulative, brightness),
        (enhance.adjust_contrast_with_mean_subtraction, contrast),
        (enhance.adjust_saturation_with_gray_subtraction, saturation),
        (enhance.adjust_hue, turn),
    )
    stacked = torch.from_numpy(np.concatenate(pair))  # (2H, W, 3): one mean for both frames
    image = stacked.permute(2, 0, 1).contiguous().float() / 255
    for kind in random.permutation(4):
        change, amount = changes[kind]
        if change is not enhance.adjust_hue or how.hue:
            image = change(image, amount)
    image = (image * 255).round().byte().permute(1, 2, 0)
    return image.numpy().reshape(pair.shape)
