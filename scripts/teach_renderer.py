"""Teach a renderer the phantom's joints and limbs: initial weights for the bundle that ships.

    python scripts/teach_renderer.py RAW DATASET OUT.safetensors [key=value ...]

RAW is what `angie phantom` wrote, DATASET what `angie prepare` made of it. MRAA finds its regions
and their masks without labels, which takes tens of thousands of steps; on two cores that is days.
For the default bundle both are therefore taught first: the heatmap of each region is drawn to a
Gaussian on a limb of the phantom whose truth is known, then the mask of each to where that limb is
in the driving frame (cross-entropies), together with the blend of deformed sources. This is a
teacher as in knowledge distillation, used for the default bundle alone; nothing in the packages
reads the truth.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import torch
from safetensors.torch import save_file
from torch import Tensor

from angie.config import override, parse_overrides, preset
from data_prep.dataset import Dataset
from data_prep.errors import BadInput, call_script
from data_prep.files import whole_file
from data_prep.progress import progress
from mraa.grid import coordinate_grid
from mraa.perceptual import PerceptualPyramid
from mraa.renderer import Renderer, from_pixels
from mraa.training.devices import keep_memory
from mraa.training.pairs import Augmentation, augment
from mraa.training.renderer import load_initial

REGION_STEPS, MASK_STEPS, RATE, SEED, SIZE = 900, 1500, 1e-3, 0, 256
JITTER = Augmentation(0, 0, brightness=0.2, contrast=0.3, saturation=0.8, hue=0.3)
ZOOM, FACE = (0.75, 2.2), np.array([128.0, 70.0])
LOSSES: list[float] = []

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


def joints_of(truth: Path) -> dict[str, np.ndarray]:
    """Joints (T, 2) in pixels by name, with those of the trunk that follow from the shoulders."""
    with np.load(truth, allow_pickle=False) as file:
        points = {str(n): file["joints"][:, i] for i, n in enumerate(file["joint_names"])}
    right, left = points["right_shoulder"], points["left_shoulder"]
    width = np.linalg.norm(left - right, axis=1, keepdims=True)
    points["chest"] = (right + left) / 2
    points["belly"] = points["chest"] + np.array([0.0, 0.9]) * width
    points["right_belly"] = points["belly"] + np.array([-0.35, 0.0]) * width
    points["left_belly"] = points["belly"] + np.array([0.35, 0.0]) * width
    return points


def region_targets(points: dict[str, np.ndarray], frame: int, move: np.ndarray) -> np.ndarray:
    """Mean and precision (K, 2 + 4) of every limb after the 2x3 map `move` to [-1, 1]."""
    rows = []
    for start, end, width in LIMBS:
        a, b = (move[:, :2] @ points[n][frame] + move[:, 2] for n in (start, end))
        length = np.linalg.norm(b - a)
        along = (b - a) / length if length > 1e-6 else np.array([1.0, 0.0])
        axes = np.stack([along, [-along[1], along[0]]], axis=1)
        spread = np.diag([1 / max(length / 3, width) ** 2, 1 / width**2])
        rows.append(np.concatenate([(a + b) / 2, (axes @ spread @ axes.T).ravel()]))
    return np.stack(rows).astype(np.float32)


class TaughtFrames:
    """Random pairs of frames of the training clips, moved and jittered, with their regions."""

    def __init__(self, raw: Path, dataset: Dataset) -> None:
        self.dataset, self.clips = dataset, dataset.clips("train")
        self.crops = {s["name"]: s["crop"] for s in dataset.manifest["sources"]}
        self.joints = {p.name.split(".")[0]: joints_of(p) for p in raw.rglob("*.truth.npz")}
        for source in sorted({clip.source for clip in self.clips} - set(self.joints)):
            raise BadInput(
                f"{raw}: has no {source}.truth.npz; give what `angie phantom` wrote for the dataset"
            )

    def draw(self, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Two frames (2, 256, 256, 3) uint8 of a clip, targets (2, K, 6) of their regions."""
        clip = self.clips[random.integers(len(self.clips))]
        numbers = random.integers(clip.n_frames, size=2)
        scale = np.exp(random.uniform(*np.log(ZOOM)))  # photos are often closer than the phantom
        offset = FACE * (1 - scale) + random.uniform(-30, 30, 2)
        shake = np.array([[scale, 0, offset[0]], [0, scale, offset[1]]])
        frames = self.dataset.frames(clip)
        moved = [
            cv2.warpAffine(frames[int(i)], shake, (SIZE, SIZE), borderMode=cv2.BORDER_REFLECT)
            for i in numbers
        ]
        crop = self.crops[clip.source]
        to_crop = SIZE / crop["size"]
        whole = shake[:, :2] @ np.array(
            [[to_crop, 0, -crop["x"] * to_crop], [0, to_crop, -crop["y"] * to_crop]]
        )
        whole[:, 2] += shake[:, 2]
        whole = whole * 2 / SIZE - np.array([[0, 0, 1], [0, 0, 1]])
        points = self.joints[clip.source]
        numbers = np.minimum(numbers + round(clip.start * 25), len(points["nose"]) - 1)
        targets = [region_targets(points, int(i), whole) for i in numbers]
        return augment(np.stack(moved), JITTER, random), np.stack(targets)

    def batch(self, random: np.random.Generator, size: int) -> tuple[Tensor, Tensor]:
        """`size` pairs: images (B, 2, 3, 256, 256) in [0, 1] and targets (B, 2, K, 6)."""
        images, targets = zip(*(self.draw(random) for _ in range(size)), strict=True)
        pictures = torch.from_numpy(np.stack(images))
        return from_pixels(pictures.flatten(0, 1)).unflatten(0, (size, 2)), torch.from_numpy(
            np.stack(targets)
        )


def limb_powers(targets: Tensor, height: int, width: int) -> Tensor:
    """Exponents of the limbs' Gaussians (B, K, h, w)."""
    offset = coordinate_grid(height, width) - targets[..., None, None, :2]
    precision = targets[..., 2:].unflatten(-1, (2, 2))
    return -0.5 * torch.einsum("bkhwi,bkij,bkhwj->bkhw", offset, precision, offset)


def target_heatmaps(targets: Tensor, height: int, width: int) -> Tensor:
    """Gaussians (B, K, h * w) that sum to 1."""
    return torch.softmax(limb_powers(targets, height, width).flatten(2), dim=2)


def target_masks(targets: Tensor, height: int, width: int) -> Tensor:
    """Whose each pixel is (B, K + 1, h, w): arms before trunk, background where no limb is."""
    density = torch.exp(1.5 * limb_powers(targets, height, width))
    arms = density[:, TRUNK:].amax(1, keepdim=True)
    density = torch.cat([density[:, :TRUNK] * (1 - arms), density[:, TRUNK:]], dim=1)
    ground = torch.full_like(density[:, :1], 0.15)
    return (total := torch.cat([ground, density], dim=1)) / total.sum(1, keepdim=True)


def teach_regions(renderer: Renderer, frames: TaughtFrames, random: np.random.Generator) -> None:
    """Draw the heatmaps to the limbs."""
    estimator = renderer.estimator
    optimizer = torch.optim.Adam(estimator.parameters(), lr=RATE)
    for _ in course("teach regions", REGION_STEPS, optimizer):
        images, targets = frames.batch(random, 6)
        with torch.autocast("cpu", torch.bfloat16):
            features = estimator.hourglass(estimator.down(images.flatten(0, 1)))
        logits = estimator.regions(features.float()) / estimator.temperature
        wanted = target_heatmaps(targets.flatten(0, 1), *logits.shape[2:])
        loss = -(wanted * torch.log_softmax(logits.flatten(2), dim=2)).sum(2).mean()
        step(loss, optimizer)


def teach_masks(renderer: Renderer, frames: TaughtFrames, random: np.random.Generator) -> None:
    """Draw the masks to the limbs of the driving frame and the blend to its picture."""
    renderer.estimator.eval()
    optimizer = torch.optim.Adam(renderer.flow.parameters(), lr=RATE)
    perceptual = PerceptualPyramid(width=16, scales=(1.0, 0.5, 0.25), weight=1.0)
    for part in course("teach masks", MASK_STEPS, optimizer):
        images, targets = frames.batch(random, 8)
        source, driving = images.unbind(1)
        with torch.autocast("cpu", torch.bfloat16):
            with torch.no_grad():
                both = renderer.estimator(torch.cat([source, driving]))
            flow = renderer.flow(source, both[: len(source)], both[len(source) :])
            match = perceptual(flow.blend, renderer.flow.down(driving))
        wanted = target_masks(targets[:, 1], *flow.masks.shape[2:])
        entropy = -(wanted * flow.masks.clamp(min=1e-6).log()).sum(1).mean()
        step(match + (1 - part) * entropy, optimizer)


def course(name: str, steps: int, optimizer: torch.optim.Optimizer) -> Iterator[float]:
    """The part done before each step, with progress; the rate falls at 80 %."""
    with progress(name, steps) as advance:
        for number in range(steps):
            for group in optimizer.param_groups:
                group["lr"] = RATE * (0.1 if number > 0.8 * steps else 1.0)
            yield number / steps
            advance(1)


def step(loss: Tensor, optimizer: torch.optim.Optimizer) -> None:
    """One step of the optimiser."""
    loss.backward()
    optimizer.step()
    optimizer.zero_grad()
    LOSSES.append(loss.item())
    if len(LOSSES) % 50 == 0:
        print(len(LOSSES), round(float(np.mean(LOSSES[-50:])), 4), flush=True)


def main() -> None:
    """Teach and write the weights of a whole renderer, of which estimator and masks are taught."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("raw", type=Path, help="folder that `angie phantom` wrote")
    parser.add_argument("dataset", type=Path, help="what `angie prepare` made of it")
    parser.add_argument("output", type=Path, help="the .safetensors to write")
    parser.add_argument("settings", nargs="*", help="key=value, over the preset lite")
    given = parser.parse_args()
    settings = override(preset("lite"), parse_overrides(given.settings))
    if settings.renderer.regions != len(LIMBS):
        raise BadInput(f"{len(LIMBS)} regions are taught, not {settings.renderer.regions}")
    keep_memory()
    torch.manual_seed(SEED)
    random = np.random.default_rng(SEED)
    renderer = Renderer(settings.renderer).to(memory_format=torch.channels_last)
    if settings.train_renderer.initial:
        load_initial(renderer, Path(settings.train_renderer.initial))
    frames = TaughtFrames(given.raw, Dataset(given.dataset))
    teach_regions(renderer, frames, random)
    teach_masks(renderer, frames, random)
    with whole_file(given.output, force=True) as part:
        save_file({k: v.contiguous() for k, v in renderer.state_dict().items()}, part)


if __name__ == "__main__":
    call_script(main)
