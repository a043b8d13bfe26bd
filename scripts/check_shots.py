"""Count cuts, fades and flashes found, and false alarms, in sequences joined from real videos.

python scripts/check_shots.py FOLDER [--joins 300] [--seed 0]
"""

import argparse
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from data_prep.media.video import read_frames
from data_prep.prepare.shots import ShotDetector
from data_prep.prepare.source import EXTENSIONS

SIZE = (320, 180)
LENGTHS = {"cut": (0,), "dissolve": (12, 25, 50), "black": (16, 30), "white": (16, 30)}
KINDS = (*LENGTHS, "flash")


@dataclass(frozen=True)
class Join:
    """Where two pieces meet: `[first, stop)` shows both, or neither; empty for a cut."""

    kind: str
    first: int
    stop: int


@dataclass(frozen=True)
class Piece:
    """Where a part of the sequence was taken from."""

    name: str
    first: int
    at: int
    count: int


def load(folder: Path) -> dict[str, np.ndarray]:
    """Every video of a folder as `(T, 180, 320, 3)` uint8 at 25 fps; at most 40 s of each."""
    videos = {}
    for path in sorted(p for p in folder.rglob("*") if p.suffix.lower() in EXTENSIONS):
        frames = [
            cv2.resize(frame, SIZE, interpolation=cv2.INTER_AREA)
            for frame, _ in zip(read_frames(path), range(1000), strict=False)
        ]
        videos[path.stem] = np.stack(frames)
    return videos


def mixed(kind: str, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Frames that lead from `a` to `b`, as many as each has."""
    t = (np.arange(len(a)) + 1)[:, None, None, None] / (len(a) + 1)
    if kind == "dissolve":
        return ((1 - t) * a + t * b).astype(np.uint8)
    level = 0.0 if kind == "black" else 255.0
    rise = np.abs(2 * t - 1)
    return np.where(t < 0.5, rise * a + (1 - rise) * level, rise * b + (1 - rise) * level).astype(
        np.uint8
    )


def sequence(
    videos: dict[str, np.ndarray], rng: np.random.Generator, kinds: list[str]
) -> tuple[np.ndarray, list[Join], list[Piece]]:
    """Pieces of 60 to 150 frames joined in the given ways, and where."""
    parts: list[np.ndarray] = []
    joins: list[Join] = []
    pieces: list[Piece] = []
    at, tail = 0, None
    names = list(videos)
    last = ""
    for kind in [*kinds, "end"]:
        name = str(rng.choice([n for n in names if n != last or len(names) == 1]))
        last = name
        video = videos[name]
        overlap = 0 if kind in ("cut", "flash", "end") else int(rng.choice(LENGTHS[kind]))
        before = 0 if tail is None else len(tail[1])
        count = min(int(rng.integers(60, 150)) + before + overlap, len(video))
        first = int(rng.integers(0, len(video) - count + 1))
        part = video[first : first + count].copy()
        if tail is not None:
            way, ending = tail
            if len(ending):
                part[:before] = mixed(way, ending, part[:before])
            joins.append(Join(way, at, at + before))
        pieces.append(Piece(name, first, at, count - overlap))
        if kind == "flash":
            place, length = len(part) // 2, int(rng.integers(1, 4))
            lit = part[place : place + length].astype(np.float32)
            part[place : place + length] = 255 - (255 - lit) * rng.uniform(0.1, 0.5)
            joins.append(Join("flash", at + place, at + place + length))
        tail = ("cut" if kind == "flash" else kind, part[len(part) - overlap :])
        parts.append(part[: len(part) - overlap])
        at += len(parts[-1])
    return np.concatenate(parts), sorted(joins, key=lambda j: j.first), pieces


def judge(
    joins: list[Join], shots: list[tuple[int, int]], edges: list[int]
) -> tuple[Counter[str], list[int]]:
    """Joins found, by kind, and the edges that no join explains.

    A join is found when no shot of 25 frames or more reaches over its middle; a flash when it
    is separated from the pictures on both sides.
    """
    found: Counter[str] = Counter()
    for join in joins:
        middle = (join.first + join.stop) // 2
        over = any(a < middle < b and b - a >= 25 for a, b in shots)
        if join.kind == "flash":
            over = any(a < join.stop and b > join.first and b - a >= 25 for a, b in shots)
        elif join.kind == "cut":
            over = over or not any(abs(edge - join.first) <= 1 for edge in edges)
        found[join.kind] += not over
    far = [e for e in edges if all(e < j.first - 12 or e > j.stop + 12 for j in joins)]
    return found, far


def own_shots(frames: np.ndarray) -> tuple[list[tuple[int, int]], list[int]]:
    """Shots, and the frames at which shots or fades begin."""
    detector = ShotDetector()
    for frame in frames:
        detector.add(cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY))
    shots = detector.shots()
    return [(s.first, s.stop) for s in shots if not s.faded], [s.first for s in shots][1:]


def sequences(
    videos: dict[str, np.ndarray], joins: int, seed: int
) -> Iterator[tuple[np.ndarray, list[Join], list[Piece]]]:
    """Sequences of ten joins each."""
    rng = np.random.default_rng(seed)
    for _ in range(-(-joins // 10)):
        yield sequence(videos, rng, [str(k) for k in rng.choice(KINDS, 10)])


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--joins", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    total: Counter[str] = Counter()
    found: Counter[str] = Counter()
    false: Counter[str] = Counter()
    frames = 0
    for pictures, joins, pieces in sequences(load(options.folder), options.joins, options.seed):
        frames += len(pictures)
        total.update(join.kind for join in joins)
        hits, far = judge(joins, *own_shots(pictures))
        found.update(hits)
        for edge in far:
            piece = [p for p in pieces if p.at <= edge][-1]
            false[f"{piece.name} frame {piece.first + edge - piece.at}"] += 1
    for kind in KINDS:
        print(f"{kind:9} {found[kind]:4} of {total[kind]:4} found")
    print(f"false alarms: {sum(false.values())} in {frames / 25 / 60:.1f} minutes")
    for place, count in false.most_common():
        print(f"  {place}: {count}")


if __name__ == "__main__":
    main()
