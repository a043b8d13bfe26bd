"""How well the regions of a bundle explain the phantom's true joints, and what it reconstructs.

    python scripts/check_regions.py RAW DATASET BUNDLE [--stride 5] [--without SOURCE,...]

RAW is what `angie phantom` wrote, or a folder of avatars with their truth, DATASET what `angie
prepare` made of it, BUNDLE one whose renderer was trained on DATASET (the shipped one began with
weights of `angie teach`). A linear map from the K shifts of a frame to the
joints is fitted on the training clips, and predicts head, elbows and wrists on the test clips:

    R^2 = 1 - sum |p - p^|^2 / sum |p - mean p|^2

for each joint, x and y together. "all" takes the mean over all test frames, "speaker" the mean of
each speaker's test frames, so that knowing who is seen earns nothing. The baseline is the same map
from as many numbers (2 K) that do without regions: principal components of the picture at 32x32.
`--without` leaves out test videos that an earlier course of the bundle's training has seen.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np
import torch

from angie.bundle import Bundle
from angie.evaluation.space import true_joints
from data_prep.dataset import Clip, Dataset
from data_prep.errors import BadInput, call_script
from data_prep.phantom.skeleton import JOINTS
from data_prep.rates import IMAGE_SIZE
from mraa.reconstruction import reconstruct
from mraa.regions import RegionEstimator
from mraa.renderer import from_pixels

GROUPS = {
    "head": ("nose",),
    "elbows": ("right_elbow", "left_elbow"),
    "wrists": ("right_wrist", "left_wrist"),
}
"""Joints that are predicted, by the name of their row."""

NAMES = [name for group in GROUPS.values() for name in group]


class Frames:
    """Every `stride`-th frame of some clips: regions, small pictures, joints, speakers."""

    def __init__(self, dataset: Dataset, clips: list[Clip], joints: dict[str, np.ndarray]) -> None:
        self.dataset, self.clips, self.joints = dataset, clips, joints

    def read(self, estimator: RegionEstimator, stride: int) -> tuple[np.ndarray, ...]:
        """Shifts (n, 2K), pictures (n, 3072), joints (n, J, 2) in [-1, 1], speakers (n,)."""
        rows: list[tuple[np.ndarray, ...]] = []
        for clip in self.clips:
            store = self.dataset.frames(clip)
            truth = self.joints[clip.id] / (IMAGE_SIZE / 2) - 1
            numbers = range(0, len(store), stride)
            frames = np.stack([store[i] for i in numbers])
            with torch.no_grad():
                shift = estimator(from_pixels(torch.from_numpy(frames))).shift
            small = [cv2.resize(f, (32, 32), interpolation=cv2.INTER_AREA).ravel() for f in frames]
            who = np.full(len(frames), self.dataset.speakers().index(clip.speaker))
            rows.append(
                (shift.flatten(1).numpy(), np.stack(small) / 255.0, truth[list(numbers)], who)
            )
        return tuple(np.concatenate(column) for column in zip(*rows, strict=True))


def linear_map(known: np.ndarray, wanted: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Least-squares map, with an offset, from `known` (n, a) to `wanted` (n, b); of `seen`."""
    ones = np.ones((len(known), 1))
    weights = np.linalg.lstsq(np.hstack([known, ones]), wanted, rcond=None)[0]
    return np.hstack([seen, np.ones((len(seen), 1))]) @ weights


def explained(truth: np.ndarray, guess: np.ndarray, who: np.ndarray) -> dict[str, list[float]]:
    """R^2 of each row of `GROUPS` and their mean over joints: [all, speaker]."""
    error = ((truth - guess) ** 2).sum(axis=(0, 2))
    within = np.concatenate([truth[who == w] - truth[who == w].mean(0) for w in np.unique(who)])
    spreads = [((truth - truth.mean(0)) ** 2).sum(axis=(0, 2)), (within**2).sum(axis=(0, 2))]
    scores = np.stack([1 - error / spread for spread in spreads])  # (2, J)
    table = {
        row: scores[:, [NAMES.index(n) for n in group]].mean(1).tolist()
        for row, group in GROUPS.items()
    }
    return {**table, "mean": scores.mean(1).tolist()}


def main() -> None:
    """Print both tables in Markdown."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    for name in ("raw", "dataset", "bundle"):
        parser.add_argument(name, type=Path)
    parser.add_argument("--stride", type=int, default=5)
    parser.add_argument("--without", default="")
    given = parser.parse_args()
    dataset, stride = Dataset(given.dataset), given.stride
    unseen = [c for c in dataset.clips("test") if c.source not in given.without.split(",")]
    if stride < 1 or not unseen:
        raise BadInput("no test frames are left: give a --stride above 0, fewer videos --without")
    places = [JOINTS.index(name) for name in NAMES]
    joints = {k: points[:, places] for k, points in true_joints(dataset, given.raw).items()}
    for clip in (*dataset.clips("train"), *unseen):
        if clip.id not in joints:
            raise BadInput(f"{given.raw}: holds no truth (*.truth.npz) of {clip.source}")
    renderer = Bundle.open(given.bundle).renderer()
    train = Frames(dataset, dataset.clips("train"), joints).read(renderer.estimator, stride)
    test = Frames(dataset, unseen, joints).read(renderer.estimator, stride)
    centre = train[1].mean(0)
    axes = np.linalg.svd(train[1][::3] - centre, full_matrices=False)[2][: train[0].shape[1]]
    inputs = {
        "regions": (train[0], test[0]),
        "components of the picture": ((train[1] - centre) @ axes.T, (test[1] - centre) @ axes.T),
    }
    videos = len({clip.source for clip in unseen})
    print(
        f"{len(train[0])} frames to fit, {len(test[0])} of {len(unseen)} clips, {videos} videos\n"
    )
    print("| R^2, all / speaker | " + " | ".join([*GROUPS, "mean"]) + " |")
    print("|---" * (len(GROUPS) + 2) + "|")
    wanted = train[2].reshape(len(train[2]), -1)
    for name, (known, seen) in inputs.items():
        guess = linear_map(known, wanted, seen).reshape(test[2].shape)
        scores = explained(test[2], guess, test[3])
        cells = [f"{a:.3f} / {b:.3f}" for a, b in scores.values()]
        print(f"| {name} | " + " | ".join(cells) + " |")
    score = reconstruct(renderer, dataset, unseen)
    print(f"\nreconstruction from the first frame, {score.frames} frames: {score.as_dict()}")


if __name__ == "__main__":
    call_script(main)
