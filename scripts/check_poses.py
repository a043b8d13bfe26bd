"""How results fall as the photo's pose departs from rest: the failure that the paper names.

    python scripts/check_poses.py DATASET BUNDLE [--bins 5] [--clips 12] [--targets 6]

The photo is each time a frame of a test clip, from the nearest to the speaker's rest pose to the
farthest in it. A pose's departure is the root mean square of its displacement from rest in units of
the training displacement's deviation. By fifths of the departure:

pictures   the same other frames of the clip drawn from that photo by their true regions (the
           renderer alone): L1 and perceptual distance to the recorded frames. `apart` is how far
           those poses are from the photo's, in the same units.
motion     gestures to the clip's sound from that pose: share of the frames whose shift lies outside
           the range of the training displacement (0.2 to 99.8 %) in any channel, and beat
           consistency.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from scipy.stats import spearmanr

from angie.bundle import Bundle
from angie.evaluation.images import open_session, pick, read_chosen
from angie.evaluation.space import RegionSpace, onsets_within, open_space, points
from angie.generators.base import GestureGenerator
from angie.metrics.beats import consistency
from angie.motion.clips import MotionClip
from angie.motion.statistics import MotionStatistics
from data_prep.dataset import Dataset
from data_prep.errors import BadInput, call_script
from data_prep.rates import FPS
from mraa.draw import regions_of
from mraa.perceptual import PerceptualDistance, score
from mraa.renderer import Renderer, from_pixels


@dataclass(frozen=True)
class Trial:
    """A photo of a pose, and what came of it; scores are NaN where there is none."""

    departure: float
    apart: float
    l1: float
    perceptual: float
    outside: float
    bc: float


def departures(clip: MotionClip, statistics: MotionStatistics) -> np.ndarray:
    """Departure (T,) of every pose of a clip from its speaker's rest pose."""
    moved = clip.motion.vector() - statistics.rest_of(clip.speaker)
    return (moved / statistics.pose_scale).square().mean(-1).sqrt().numpy()


def sources(departure: np.ndarray, count: int) -> list[int]:
    """Frames evenly spread over the ranks of departure, the nearest and the farthest among them."""
    order = np.argsort(departure, kind="stable")
    places = np.linspace(0, len(order) - 1, count).round().astype(int)
    return list(dict.fromkeys(order[places].tolist()))


@torch.no_grad()
def try_photo(
    data: Dataset, space: RegionSpace, renderer: Renderer, generator: GestureGenerator,
    clip: MotionClip, source: int, targets: np.ndarray, judge: PerceptualDistance,
) -> Trial:  # fmt: skip
    """One frame of a clip as the photo."""
    statistics, stored = space.statistics, {c.id: c for c in data.clips()}[clip.name]
    pose = clip.motion[source : source + 1]
    numbers = np.array([source, *targets])
    frames, _ = read_chosen(data, stored, numbers)
    session = open_session(renderer, frames[0], pose)
    driving = regions_of(renderer, pick(clip.motion, targets), session.device)
    made = np.concatenate(list(session.frames(driving)))
    pair = [from_pixels(torch.from_numpy(x)) for x in (made, frames[1:])]
    seen = score(pair[0], pair[1], judge)
    away = (pick(clip.motion, targets).vector() - pose.vector()) / statistics.pose_scale
    motion = generator.generate(clip.speech, pose, clip.motion.frames, greedy=None)
    split = 2 * statistics.regions
    moved = motion.vector() - statistics.rest_of(clip.speaker)
    over = (moved < statistics.low) | (moved > statistics.high)
    onsets = onsets_within(clip, motion.frames)
    beat = consistency([points(motion)[:, space.active]], [onsets], space.usual, FPS)
    return Trial(
        float(departures(clip, statistics)[source]),
        float(away.square().mean(-1).sqrt().mean()),
        float(seen.l1.mean()),
        float(seen.perceptual.mean()),
        float(over[:, :split].any(-1).float().mean()),
        float("nan") if beat.value is None else beat.value,
    )


def table(trials: list[Trial], bins: int) -> list[str]:
    """A line for each part of the trials by departure, and Spearman's correlations with it."""
    order = sorted(trials, key=lambda trial: trial.departure)
    names = ("departure", "apart", "l1", "perceptual", "outside", "bc")
    lines = ["".join(f"{name:>12}" for name in names)]
    for part in np.array_split(np.arange(len(order)), min(bins, len(order))):
        means = [np.nanmean([getattr(order[i], name) for i in part]) for name in names]
        lines.append("".join(f"{value:12.4f}" for value in means))
    ranks = []
    for name in names[1:]:
        pairs = [(t.departure, getattr(t, name)) for t in order if np.isfinite(getattr(t, name))]
        ranks.append(f"{name} {spearmanr(*zip(*pairs, strict=True)).statistic:+.2f}")
    return [*lines, f"rank correlation with departure: {', '.join(ranks)}"]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset", type=Path)
    parser.add_argument("bundle", type=Path)
    parser.add_argument("--bins", type=int, default=5)
    parser.add_argument("--clips", type=int, default=12, help="test clips, at most")
    parser.add_argument("--targets", type=int, default=6, help="frames drawn from each photo")
    given = parser.parse_args()
    if min(given.bins, given.clips, given.targets) < 1:
        raise BadInput("--bins, --clips and --targets must be positive")
    data, bundle = Dataset(given.dataset), Bundle.open(given.bundle)
    generator, renderer, judge = bundle.generator(), bundle.renderer(), PerceptualDistance("")
    space = open_space(data, bundle, bundle.train / "scratch", "cpu")
    clips = space.test[:: max(1, len(space.test) // given.clips)][: given.clips]
    trials = []
    for clip in clips:
        targets = np.linspace(0, clip.motion.frames - 1, given.targets).round().astype(int)
        for source in sources(departures(clip, space.statistics), given.bins):
            trials.append(try_photo(data, space, renderer, generator, clip, source, targets, judge))
    print("\n".join(table(trials, given.bins)))


if __name__ == "__main__":
    call_script(main)
