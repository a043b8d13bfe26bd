"""Minutes of video prepared per minute, beside plain decoding of the same file.

python scripts/bench_prepare.py [VIDEO...] [--minutes 1] [--jobs 2] [--rounds 3] [--models MODELS]

Without a video a phantom of the given length is written to a temporary folder first, one file a
process. Both are measured in turns, each round decoding once and preparing once, so that other
work on the machine weighs on both alike; the ratio is of the medians.
"""

import argparse
import functools
import statistics
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import av
import cv2

from data_prep.media.video import probe
from data_prep.phantom.make import make_phantom
from data_prep.prepare.clips import FOLDERS
from data_prep.prepare.ingest import ingest
from data_prep.prepare.source import IngestionConfig, Source


def decode(path: Path) -> None:
    """Every frame as the decoder gives it, on one thread, and every sound sample."""
    for kind in ("video", "audio"):
        with av.open(str(path)) as container:
            for stream in getattr(container.streams, kind)[:1]:
                stream.codec_context.thread_count = 1
                for _ in container.decode(stream):
                    pass


def prepare(path: Path, models: Path | None = None) -> None:
    """The whole way to clips."""
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as folder:
        for name in FOLDERS:
            (Path(folder) / name).mkdir()
        config = IngestionConfig(silent_ok=True)
        outcome = ingest(Source(path, "bench", path.stem), Path(folder), config, models=models)
    if outcome.refused is not None:
        raise SystemExit(f"{path}: {outcome.refused}; give another video")


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("videos", type=Path, nargs="*")
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--models", type=Path, help="folder with BlazeFace")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        videos = options.videos
        if not videos:
            videos = make_phantom(
                Path(folder),
                minutes=options.minutes,
                seed=0,
                presenters=options.jobs,
                jobs=options.jobs,
            )
        minutes = sum(probe(path).duration for path in videos) / 60
        works = {"decode": decode, "prepare": functools.partial(prepare, models=options.models)}
        measured: dict[str, list[float]] = {name: [] for name in works}
        with ProcessPoolExecutor(options.jobs, get_context("spawn")) as pool:
            list(pool.map(probe, videos))  # the processes start and import before the clock does
            for _ in range(options.rounds):
                for name, work in works.items():
                    begin = time.perf_counter()
                    list(pool.map(work, videos))
                    measured[name].append(time.perf_counter() - begin)
    rates = {name: minutes * 60 / statistics.median(times) for name, times in measured.items()}
    print(f"{len(videos)} videos, {minutes:.2f} minutes, {options.jobs} processes")
    for name, rate in rates.items():
        print(f"{name:8} {rate:7.2f} minutes of video per minute")
    print(f"preparing takes {rates['decode'] / rates['prepare']:.1f} times as long as decoding")


if __name__ == "__main__":
    main()
