"""Teach a region estimator the phantom's joints: initial weights for the bundle that ships.

    python scripts/teach_regions.py RAW DATASET OUT.safetensors [key=value ...]

RAW is what `angie phantom` wrote, DATASET what `angie prepare` made of it. MRAA finds its regions
without labels, which takes tens of thousands of steps; on two cores that is days. For the default
bundle the regions are therefore taught first: the heatmap of each is drawn to a Gaussian on a limb
of the phantom whose truth is known (cross-entropy). This is a teacher as in knowledge distillation,
used for the default bundle alone; nothing in the packages reads the truth.
"""

import sys
from pathlib import Path

import cv2
import numpy as np
import torch
from safetensors.torch import save_file
from torch import Tensor

from angie.presets import override, parse_overrides, preset
from data_prep.dataset import Dataset
from data_prep.progress import progress
from mraa.allocator import keep_memory
from mraa.grid import coordinate_grid
from mraa.pairs import Augmentation, augment
from mraa.renderer import Renderer, from_pixels

STEPS, BATCH, RATE, SEED = 600, 12, 1e-3, 0

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
    """Random frames of the training clips, moved and jittered, with their regions."""

    def __init__(self, raw: Path, dataset: Dataset) -> None:
        self.dataset, self.clips = dataset, dataset.clips("train")
        self.crops = {s["name"]: s["crop"] for s in dataset.manifest["sources"]}
        self.joints = {p.name.split(".")[0]: joints_of(p) for p in raw.rglob("*.truth.npz")}

    def draw(self, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """A frame (256, 256, 3) uint8 and the targets (K, 6) of its regions."""
        clip = self.clips[random.integers(len(self.clips))]
        frame = int(random.integers(clip.n_frames))
        crop, size = self.crops[clip.source], 256
        scale = random.uniform(0.8, 1.2)
        offset = size / 2 * (1 - scale) + random.uniform(-30, 30, 2)
        shake = np.array([[scale, 0, offset[0]], [0, scale, offset[1]]])
        image = cv2.warpAffine(
            self.dataset.frames(clip)[frame], shake, (size, size), borderMode=cv2.BORDER_REFLECT
        )
        pair = np.stack([image, image])
        image = augment(pair, Augmentation(horizontal_flip=0, contrast=0.3, saturation=0.3), random)
        to_crop = size / crop["size"]
        move = np.array([[to_crop, 0, -crop["x"] * to_crop], [0, to_crop, -crop["y"] * to_crop]])
        whole = shake[:, :2] @ move
        whole[:, 2] += shake[:, 2]
        whole = whole * 2 / size - np.array([[0, 0, 1], [0, 0, 1]])
        number = min(frame + round(clip.start * 25), len(next(iter(self.joints.values()))["nose"]))
        points = self.joints[clip.source]
        return image[0], region_targets(points, min(number, len(points["nose"]) - 1), whole)


def target_heatmaps(targets: Tensor, height: int, width: int) -> Tensor:
    """Gaussians (B, K, h * w) that sum to 1."""
    offset = coordinate_grid(height, width) - targets[..., None, None, :2]
    precision = targets[..., 2:].unflatten(-1, (2, 2))
    power = torch.einsum("bkhwi,bkij,bkhwj->bkhw", offset, precision, offset)
    return torch.softmax(-0.5 * power.flatten(2), dim=2)


def main() -> None:
    """Train and write the weights of a whole renderer, of which the estimator is taught."""
    raw, dataset, output = (Path(a) for a in sys.argv[1:4])
    settings = override(preset("lite"), parse_overrides(sys.argv[4:]))
    if settings.renderer.regions != len(LIMBS):
        raise SystemExit(f"{len(LIMBS)} regions are taught, not {settings.renderer.regions}")
    keep_memory()
    torch.manual_seed(SEED)
    random = np.random.default_rng(SEED)
    renderer = Renderer(settings.renderer).to(memory_format=torch.channels_last)
    estimator = renderer.estimator
    optimizer = torch.optim.Adam(estimator.parameters(), lr=RATE)
    frames = TaughtFrames(raw, Dataset(dataset))
    with progress("teach", STEPS) as advance:
        for step in range(STEPS):
            for group in optimizer.param_groups:
                group["lr"] = RATE * (0.1 if step > 0.8 * STEPS else 1.0)
            images, targets = zip(*(frames.draw(random) for _ in range(BATCH)), strict=True)
            batch = from_pixels(torch.from_numpy(np.stack(images)))
            with torch.autocast("cpu", torch.bfloat16):
                features = estimator.hourglass(estimator.down(batch))
            logits = estimator.regions(features.float()) / estimator.temperature
            wanted = target_heatmaps(torch.from_numpy(np.stack(targets)), *logits.shape[2:])
            loss = -(wanted * torch.log_softmax(logits.flatten(2), dim=2)).sum(2).mean()
            loss.backward()
            optimizer.step()
            optimizer.zero_grad()
            advance(1, f"cross-entropy {loss.item():.3f}")
            if step % 50 == 0:
                print(step, round(loss.item(), 3), flush=True)
    save_file({k: v.contiguous() for k, v in renderer.state_dict().items()}, output)


if __name__ == "__main__":
    main()
