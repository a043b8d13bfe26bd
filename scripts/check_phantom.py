"""Check that the truth of phantom videos agrees with their sound.

    python scripts/check_phantom.py RAW [--derangements 5]

RAW is what `angie phantom` wrote. Prints, by presenter and in all:

- strokes: the share that starts within a frame of its stated onset, and the same for onsets
  stated 0.3 s late, as a control;
- beat consistency and percentage of matched beats between true motion and its own sound, and
  between true motion and the sound of other videos, cut to the shorter of the two. `hands` scores
  wrists and hands, `arms` the angles at shoulders and elbows. See `data_prep.speech.synchrony`.
"""

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from data_prep.media.audio import read_sound
from data_prep.phantom.skeleton import JOINTS
from data_prep.rates import FPS, SAMPLE_RATE
from data_prep.speech import synchrony
from data_prep.speech.features import Speech

ACTIVE = ("right_wrist", "right_hand", "left_wrist", "left_hand")
"""Joints whose motion is scored."""

LEVEL = 0.05
"""Share of a movement's largest speed at which it counts as begun."""


def steps(joints: NDArray) -> NDArray:
    """Distances (T, 4) that the active joints go in the frame before each, first row zero.

    Args:
        joints: (T, J, 2) as `data_prep.phantom.skeleton.JOINTS`, any unit.
    """
    return synchrony.steps(joints[:, [JOINTS.index(name) for name in ACTIVE]])


def arm_turns(joints: NDArray) -> NDArray:
    """Changes (T, 4) of the angles at shoulders and elbows in each frame, radians."""
    at = {name: joints[:, index].astype(np.float64) for index, name in enumerate(JOINTS)}
    angles = []
    for side in ("right", "left"):
        chain = ["neck", f"{side}_shoulder", f"{side}_elbow", f"{side}_wrist"]
        bones = [at[b] - at[a] for a, b in zip(chain[:-1], chain[1:], strict=True)]
        for first, second in zip(bones[:-1], bones[1:], strict=True):
            lengths = np.linalg.norm(first, axis=-1) * np.linalg.norm(second, axis=-1)
            cosine = (first * second).sum(-1) / np.maximum(lengths, 1e-9)
            angles.append(np.arccos(np.clip(cosine, -1, 1)))
    turned = np.abs(np.diff(np.stack(angles, 1), axis=0))
    return np.concatenate([np.zeros((1, 4)), turned])


def stroke_start(joints: NDArray, hand: str, onset: float, prepared: float) -> float:
    """When a hand sets off towards a stroke, seconds; infinite when it does not.

    The speed of the wrist along the way from its place at `onset` to that at `prepared` rises
    through `LEVEL` of its largest there; of several such moments, the one nearest to `onset`.

    Args:
        joints: (T, J, 2) as `data_prep.phantom.skeleton.JOINTS`, any unit.
        hand: "right", "left" or "both", as the truth has it.
        onset: stated start of the stroke, seconds.
        prepared: stated end of its preparation, seconds.
    """
    path = joints[:, JOINTS.index("left_wrist" if hand == "left" else "right_wrist")]
    path = path.astype(np.float64)
    first, last = max(round((onset - 0.2) * FPS), 0), min(round(prepared * FPS), len(path) - 1)
    way = path[last] - path[min(round(onset * FPS), last - 1)]
    speed = np.diff(path[first : last + 1], axis=0) @ (way / max(np.linalg.norm(way), 1e-6))
    level = LEVEL * speed.max()
    rises = np.flatnonzero((speed[:-1] < level) & (speed[1:] >= level))
    if not len(rises):
        return np.inf
    share = (level - speed[rises]) / (speed[rises + 1] - speed[rises])
    times = (first + 0.5 + rises + share) / FPS
    return float(times[np.argmin(np.abs(times - onset))])


CHANGES: dict[str, Callable[[NDArray], NDArray]] = {"hands": steps, "arms": arm_turns}


@dataclass(frozen=True)
class Clip:
    """One video: its presenter, truth and sound."""

    presenter: str
    joints: NDArray  # (T, J, 2)
    onsets: NDArray  # (n,) of the sound, seconds
    strokes: list[tuple[str, float, float]]  # hand, onset, end of preparation

    @property
    def seconds(self) -> float:
        """Length of the video."""
        return len(self.joints) / FPS


def read(video: Path) -> Clip:
    """The truth and the sound of one video."""
    with np.load(video.with_suffix(".truth.npz"), allow_pickle=False) as truth:
        hands = [str(hand) for hand in truth["stroke_hand"]]
        strokes = zip(
            hands, truth["stroke_onset"].tolist(), truth["stroke_prepared"].tolist(), strict=True
        )
        name, joints = str(truth["presenter"]), truth["joints"]
        samples = read_sound(video, SAMPLE_RATE)
        return Clip(name, joints, Speech(samples)["onset_times"].astype(np.float64), list(strokes))


def starts(clips: list[Clip], late: float = 0.0) -> NDArray:
    """How far each stroke starts from its stated onset plus `late`, seconds."""
    return np.array([
        stroke_start(clip.joints, hand, onset + late, prepared + late) - onset - late
        for clip in clips for hand, onset, prepared in clip.strokes
        if prepared + late < clip.seconds - 0.1
    ])  # fmt: skip


@dataclass(frozen=True)
class Beats:
    """Beats of a clip's motion for either score, seconds."""

    consistency: NDArray
    matched: NDArray


def beats(clips: list[Clip], kind: str) -> list[Beats]:
    """Motion beats of every clip; each presenter's motion is scaled by its own mean."""
    changes = [CHANGES[kind](clip.joints) for clip in clips]
    names = [clip.presenter for clip in clips]
    usual = {
        name: np.concatenate(
            [c for c, other in zip(changes, names, strict=True) if other == name]
        ).mean(0)
        for name in set(names)
    }
    curves = [synchrony.activity(c, usual[name]) for c, name in zip(changes, names, strict=True)]
    return [
        Beats(synchrony.minima(curve, FPS), synchrony.smooth_minima(change.mean(1), FPS))
        for curve, change in zip(curves, changes, strict=True)
    ]


def compared(
    clips: list[Clip], motion: list[Beats], pairs: list[tuple[int, int]]
) -> tuple[float, float]:
    """Both scores over (motion, sound) pairs of clips, weighted by the number of beats."""
    sums = np.zeros(4)
    for i, j in pairs:
        end = min(clips[i].seconds, clips[j].seconds)
        sound = clips[j].onsets[clips[j].onsets < end]
        first, second = motion[i].consistency, motion[i].matched
        first, second = first[first < end], second[second < end]
        if len(first) and len(sound):
            sums[:2] += len(sound) * synchrony.beat_consistency(first, sound), len(sound)
        if len(second) and len(sound):
            kept = synchrony.spaced(sound)
            sums[2:] += 100 * synchrony.matches(second, kept), len(second)
    return sums[0] / max(sums[1], 1), sums[2] / max(sums[3], 1)


def deranged(count: int, times: int) -> list[tuple[int, int]]:
    """Pairs (i, j) with i != j: `times` seeded derangements of `count` things."""
    rng = np.random.default_rng(0)
    pairs = []
    for _ in range(times):
        order = rng.permutation(count)
        step = int(rng.integers(1, count))
        pairs += list(zip(order.tolist(), np.roll(order, step).tolist(), strict=True))
    return pairs


def report(clips: list[Clip], derangements: int) -> None:
    """Print the tables."""
    away, control = np.abs(starts(clips)), np.abs(starts(clips, 0.3))
    print(f"{len(clips)} videos, {sum(c.seconds for c in clips) / 60:.1f} minutes")
    print(
        f"strokes: {np.mean(away <= 1 / FPS):.1%} of {len(away)} start within one frame of the "
        f"stated time (median {1000 * np.median(away):.0f} ms away); "
        f"control, stated 0.3 s late: {np.mean(control <= 1 / FPS):.1%}"
    )
    print(f"\n{'':20}{'beat consistency':>24}{'matched beats (%)':>28}")
    print(f"{'':20}{'own':>8}{'other':>8}{'diff':>8}   {'own':>9}{'other':>8}{'diff':>8}")
    others = deranged(len(clips), derangements)
    for kind in CHANGES:
        motion = beats(clips, kind)
        for name in [*sorted({clip.presenter for clip in clips}), "all"]:
            mine = [i for i, clip in enumerate(clips) if name in ("all", clip.presenter)]
            own = compared(clips, motion, [(i, i) for i in mine])
            other = compared(clips, motion, [(i, j) for i, j in others if i in mine])
            print(
                f"{kind:8}{name:12}{own[0]:8.3f}{other[0]:8.3f}{own[0] - other[0]:8.3f}   "
                f"{own[1]:9.1f}{other[1]:8.1f}{own[1] - other[1]:8.1f}"
            )


def main() -> int:
    """Read the folder and print the report."""
    parser = argparse.ArgumentParser(description="Check the truth of phantom videos.")
    parser.add_argument("raw", type=Path, help="folder that `angie phantom` wrote")
    parser.add_argument("--derangements", type=int, default=5, help="of motion against sound")
    arguments = parser.parse_args()
    videos = sorted(arguments.raw.glob("*/*.mp4"))
    if len(videos) < 2:
        print(f"{arguments.raw}: holds fewer than two videos; run `angie phantom` first",
              file=sys.stderr)  # fmt: skip
        return 2
    report([read(video) for video in videos], arguments.derangements)
    return 0


if __name__ == "__main__":
    sys.exit(main())
