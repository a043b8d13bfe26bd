"""Time for a random pair of frames of a dataset, and bytes for each frame.

    python scripts/bench_frames.py DATASET [PAIRS]

As training reads them: a random clip is opened, two random frames of it are decoded, on one core.
The files are in the system's cache after the first round, as they are in training.
"""

import argparse
import time
from pathlib import Path

import cv2
import numpy as np

from data_prep.dataset import Dataset, FrameStore
from data_prep.errors import BadInput, call_script


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("dataset", type=Path, help="folder that `angie prepare` made")
    parser.add_argument("pairs", type=int, nargs="?", default=2000, help="to read (2000)")
    given = parser.parse_args()
    if given.pairs < 1:
        raise BadInput(f"{given.pairs} pairs: give a number above 0")
    cv2.setNumThreads(1)
    data, pairs = Dataset(given.dataset), given.pairs
    clips = data.clips()
    random = np.random.default_rng(0)
    times = []
    worked = time.process_time()
    for _ in range(pairs):
        begun = time.perf_counter()
        store = data.frames(clips[int(random.integers(len(clips)))])
        first, second = random.integers(len(store), size=2)
        pair = np.stack([store[int(first)], store[int(second)]])
        times.append(time.perf_counter() - begun)
    worked = 1000 * (time.process_time() - worked) / pairs
    assert pair.shape == (2, 256, 256, 3)
    size = sum((data.path / "frames" / f"{clip.id}.safetensors").stat().st_size for clip in clips)
    stored = sum(len(FrameStore(data.frames(clip).path)) for clip in clips)
    milliseconds = 1000 * np.array(times)
    print(
        f"{pairs} pairs: median {np.median(milliseconds):.2f} ms, "
        f"mean {milliseconds.mean():.2f} ms, 95 % under {np.percentile(milliseconds, 95):.2f} ms, "
        f"processor {worked:.2f} ms; "
        f"{size / stored / 1000:.1f} kB a frame"
    )


if __name__ == "__main__":
    call_script(main)
