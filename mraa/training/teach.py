"""Teach a renderer where limbs are: regions and masks distilled from known joints.

MRAA finds its regions and their masks without labels, which takes tens of thousands of steps. Where
joints of the people are known, drawn ones by their truth and real ones by networks that see them,
both are taught in a few hundred: the heatmap of each region is drawn to a Gaussian on a limb, then
the mask of each to where that limb is in the driving frame (cross-entropies), together with the
blend of deformed sources. This is knowledge distillation, by which ANGIE's estimator is pretrained
(section 4.1), with other teachers.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from data_prep.dataset import Dataset
from data_prep.errors import BadInput
from data_prep.rates import IMAGE_SIZE
from mraa.grid import coordinate_grid
from mraa.perceptual import PerceptualPyramid
from mraa.regions import RegionEstimator
from mraa.renderer import Renderer, from_pixels
from mraa.training.pairs import Augmentation, augment
from mraa.training.run import Run, RunConfig

JOINTS = (
    "crown", "nose", "chin", "neck", "right_shoulder", "right_elbow", "right_wrist", "right_hand",
    "left_shoulder", "left_elbow", "left_wrist", "left_hand",
)  # fmt: skip
"""Joints of a person that have to be known, in order; right is the person's own."""

LIMBS = [
    ("crown", "chin", 0.1),
    ("nose", "nose", 0.08),
    ("chin", "neck", 0.08),
    ("right_shoulder", "left_shoulder", 0.1),
    ("chest", "belly", 0.15),
    ("right_belly", "right_belly", 0.12),
    ("left_belly", "left_belly", 0.12),
    ("crown", "crown", 0.1),
]
"""Regions as limbs: from joint, to joint, width; those of the arms follow for both sides."""

TRUNK = len(LIMBS)

for side in ("right", "left"):
    LIMBS += [
        (f"{side}_shoulder", f"{side}_shoulder", 0.09),
        (f"{side}_shoulder", f"{side}_elbow", 0.07),
        (f"{side}_elbow", f"{side}_elbow", 0.08),
        (f"{side}_elbow", f"{side}_wrist", 0.06),
        (f"{side}_wrist", f"{side}_hand", 0.07),
        (f"{side}_hand", f"{side}_hand", 0.07),
    ]

ZOOM, FACE = (0.75, 2.2), np.array([128.0, 70.0])
"""Range of magnification, and the place that stays: photos are often closer than videos."""

SHIFT = 30
"""Pixels by which frames are moved at most."""

JITTER = Augmentation(0, 0, brightness=0.2, contrast=0.3, saturation=0.8, hue=0.3)

FALL = 0.8
"""Part of a course after which the rate falls to a tenth."""


@dataclass(frozen=True)
class Marks:
    """Joints in some frames of a clip."""

    frames: NDArray
    """(n,) int, numbers of the frames, at least one."""
    points: NDArray
    """(n, 12, 2) `JOINTS`, (x, y) in pixels of the frame."""
    sure: NDArray
    """(n, 12) in [0, 1], how much each is to be believed."""


@dataclass(frozen=True)
class Teaching:
    """How regions and masks are taught.

    Attributes:
        region_steps: of the regions.
        mask_steps: of the masks.
        region_batch: pairs of frames of a step of the regions.
        mask_batch: of the masks.
        rate: of Adam.
    """

    region_steps: int = 900
    mask_steps: int = 1500
    region_batch: int = 6
    mask_batch: int = 8
    rate: float = 1e-3


def check_regions(count: int) -> None:
    """Refuse a renderer that has another number of regions than there are limbs.

    Raises:
        BadInput: it has.
    """
    if count != len(LIMBS):
        raise BadInput(f"{len(LIMBS)} regions are taught, not {count}; set renderer.regions")


def with_trunk(points: NDArray, sure: NDArray) -> dict[str, tuple[NDArray, float]]:
    """Joints (12, 2) of a frame by name with what each is worth, and those of the trunk."""
    found = {name: (points[i], float(sure[i])) for i, name in enumerate(JOINTS)}
    (right, one), (left, other) = found["right_shoulder"], found["left_shoulder"]
    width, both = float(np.linalg.norm(left - right)), min(one, other)
    chest = (right + left) / 2
    belly = chest + np.array([0.0, 0.9]) * width
    aside = np.array([0.35, 0.0]) * width
    return found | {
        "chest": (chest, both),
        "belly": (belly, both),
        "right_belly": (belly - aside, both),
        "left_belly": (belly + aside, both),
    }


def region_targets(points: NDArray, sure: NDArray, move: NDArray) -> NDArray[np.float32]:
    """Mean, precision and worth (K, 2 + 4 + 1) of every limb of a frame.

    Args:
        points: (12, 2) `JOINTS`.
        sure: (12,) what each is worth.
        move: (2, 3) map of the points to [-1, 1].
    """
    known, rows = with_trunk(points, sure), []
    for start, end, width in LIMBS:
        a, b = (move[:, :2] @ known[n][0] + move[:, 2] for n in (start, end))
        length = float(np.linalg.norm(b - a))
        along = (b - a) / length if length > 1e-6 else np.array([1.0, 0.0])
        axes = np.stack([along, [-along[1], along[0]]], axis=1)
        spread = np.diag([1 / max(length / 3, width) ** 2, 1 / width**2])
        worth = min(known[start][1], known[end][1])
        centre, shape = (a + b) / 2, (axes @ spread @ axes.T).ravel()
        rows.append(np.concatenate([centre, shape, np.array([worth])]))
    return np.stack(rows).astype(np.float32)


class MarkedPairs:
    """Random pairs of marked frames of a clip, moved and jittered, with their limbs.

    Args:
        dataset: where the clips are.
        marks: of clips, by id.
    """

    def __init__(self, dataset: Dataset, marks: Mapping[str, Marks]) -> None:
        self.dataset, self.marks = dataset, marks
        self.clips = [clip for clip in dataset.clips("train") if clip.id in marks]

    def __len__(self) -> int:
        """Number of clips."""
        return len(self.clips)

    def draw(self, index: int, random: np.random.Generator) -> tuple[Tensor, Tensor]:
        """Frames (2, 256, 256, 3) uint8 and limbs (2, K, 7) of clip `index`."""
        clip = self.clips[index]
        marks, store = self.marks[clip.id], self.dataset.frames(clip)
        chosen = random.integers(len(marks.frames), size=2)
        scale = np.exp(random.uniform(*np.log(ZOOM)))
        offset = FACE * (1 - scale) + random.uniform(-SHIFT, SHIFT, 2)
        shake = np.array([[scale, 0, offset[0]], [0, scale, offset[1]]])
        size = (IMAGE_SIZE, IMAGE_SIZE)
        moved = [
            cv2.warpAffine(store[int(marks.frames[i])], shake, size, borderMode=cv2.BORDER_REFLECT)
            for i in chosen
        ]
        unit = shake * 2 / IMAGE_SIZE - np.array([[0, 0, 1], [0, 0, 1]])
        targets = [region_targets(marks.points[i], marks.sure[i], unit) for i in chosen]
        frames = augment(np.stack(moved), JITTER, random)
        return torch.from_numpy(frames), torch.from_numpy(np.stack(targets))


def limb_powers(limbs: Tensor, height: int, width: int) -> Tensor:
    """Exponents (B, K, h, w) of the Gaussians of limbs (B, K, 7)."""
    offset = coordinate_grid(height, width, limbs.device) - limbs[..., None, None, :2]
    precision = limbs[..., 2:6].unflatten(-1, (2, 2))
    return -0.5 * torch.einsum("bkhwi,bkij,bkhwj->bkhw", offset, precision, offset)


def limb_masks(limbs: Tensor, height: int, width: int) -> Tensor:
    """Whose each pixel is (B, K + 1, h, w): arms before trunk, background where no limb is."""
    density = torch.exp(1.5 * limb_powers(limbs, height, width))
    density = density * limbs[..., 6, None, None]
    arms = density[:, TRUNK:].amax(1, keepdim=True)
    density = torch.cat([density[:, :TRUNK] * (1 - arms), density[:, TRUNK:]], dim=1)
    ground = torch.full_like(density[:, :1], 0.15)
    total = torch.cat([ground, density], dim=1)
    return total / total.sum(1, keepdim=True)


class RegionLesson(nn.Module):
    """A region estimator with the loss of its heatmaps."""

    def __init__(self, estimator: RegionEstimator) -> None:
        super().__init__()
        self.estimator = estimator

    def forward(self, frames: Tensor, limbs: Tensor) -> Tensor:
        """Mean cross-entropy of frames (B, 2, H, W, 3) uint8 with limbs (B, 2, K, 7)."""
        estimator, limbs = self.estimator, limbs.flatten(0, 1)
        features = estimator.hourglass(estimator.down(from_pixels(frames.flatten(0, 1))))
        with torch.autocast(features.device.type, enabled=False):
            logits = estimator.regions(features.float()) / estimator.temperature
            wanted = torch.softmax(limb_powers(limbs, *logits.shape[2:]).flatten(2), dim=2)
            apart = -(wanted * torch.log_softmax(logits.flatten(2), dim=2)).sum(2)  # (2B, K)
        worth = limbs[..., 6]
        return (apart * worth).sum() / worth.sum().clamp(min=1)


class MaskLesson(nn.Module):
    """A flow predictor with the losses of its masks and of its blend of deformed sources."""

    def __init__(self, renderer: Renderer, compare: PerceptualPyramid) -> None:
        super().__init__()
        self.flow = renderer.flow
        self._fixed = (renderer.estimator, compare)  # in a tuple, where torch sees no state

    def forward(self, frames: Tensor, limbs: Tensor) -> tuple[Tensor, Tensor]:
        """Distance of the blend to the driving frame, and cross-entropy of the masks."""
        estimator, compare = self._fixed
        source, driving = (from_pixels(x) for x in frames.unbind(1))
        with torch.no_grad():
            both = estimator(torch.cat([source, driving]))
        flow = self.flow(source, both[: len(source)], both[len(source) :])
        match = compare(flow.blend, self.flow.down(driving))
        wanted = limb_masks(limbs[:, 1], *flow.masks.shape[2:])
        return match, -(wanted * flow.masks.float().clamp(min=1e-6).log()).sum(1).mean()


def teach(
    renderer: Renderer,
    pairs: MarkedPairs,
    folder: Path,
    how: Teaching | None = None,
    *,
    seed: int = 0,
    run_config: RunConfig | None = None,
    resume: bool = False,
) -> Renderer:
    """Teach a renderer's region estimator and masks; what else it holds stays.

    Args:
        renderer: of as many regions as there are `LIMBS`.
        pairs: marked frames, of at least one clip.
        folder: for checkpoints and curves.
        how: steps, batches, rate.
        seed: of the pairs.
        run_config: device, precision and so on.
        resume: go on from the checkpoints in `folder`.

    Returns:
        The renderer in evaluation mode on the CPU.

    Raises:
        BadInput: another number of regions, or nothing to learn from.
    """
    how = how or Teaching()
    check_regions(renderer.config.regions)
    if not len(pairs):
        raise BadInput(f"{pairs.dataset.path}: no joints are known in its training clips")
    renderer.to(memory_format=torch.channels_last)
    given: dict[str, Any] = {"seed": seed, "config": run_config, "resume": resume}

    def begin(stage: str, steps: int, lesson: nn.Module) -> tuple[Run, nn.Module]:
        run = Run(folder, stage, steps=steps, **given)
        learning = torch.optim.Adam(lesson.parameters(), lr=how.rate)
        return run, run.add("lesson", lesson, learning, [round(FALL * steps)])

    run, lesson = begin("teach-regions", how.region_steps, RegionLesson(renderer.estimator))
    batches = run.batches(pairs, how.region_batch)
    for _ in run.steps():
        loss = lesson(*next(batches))
        run.update(loss, "lesson")
        run.log(loss=loss)
    compare = PerceptualPyramid(width=16, scales=(1.0, 0.5, 0.25), weight=1.0).to(run.device)
    renderer.estimator.to(run.device).eval()
    run, lesson = begin("teach-masks", how.mask_steps, MaskLesson(renderer, compare))
    batches = run.batches(pairs, how.mask_batch)
    for step in run.steps():
        match, entropy = lesson(*next(batches))
        loss = match + (1 - step / how.mask_steps) * entropy
        run.update(loss, "lesson")
        run.log(loss=loss, match=match, masks=entropy)
    return renderer.cpu().eval()
