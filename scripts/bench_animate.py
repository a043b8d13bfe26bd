"""What `angie animate` as a whole takes: time, memory, and the encoder's part of it.

    python scripts/bench_animate.py [--speaker BUNDLE] [--seconds 10 60 600]

Speech is the built-in voice's. Each length is animated by a process of its own, after one that
fills the caches; then frames are drawn alone, and drawn and encoded, in turn. Prints tables.
"""

import angie.cli  # noqa: F401 (how OpenMP's threads wait; before torch is imported)

# isort: split
import argparse
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import torch

from angie.bundle import BUNDLE, PHOTO, Bundle
from data_prep.media.audio import write_wav
from data_prep.media.photo import read_photo
from data_prep.media.writer import VideoWriter, WriteThread
from data_prep.phantom.make import recording
from data_prep.rates import FPS, IMAGE_SIZE
from data_prep.speaker.crop import cut_out, find_faces, speaker_crop
from mraa.draw import render, source_pose
from mraa.motion import Motion
from mraa.renderer import from_pixels
from mraa.training.devices import keep_memory

FRAMES = 150
"""Frames drawn for the encoder's part."""

ROUNDS = 3


def speech(path: Path, seconds: float) -> None:
    """Write a recording, in a process of its own: a child's peak counts that of its parent."""
    make = multiprocessing.get_context("spawn").Process(target=speak, args=(path, seconds))
    make.start()
    make.join()


def speak(path: Path, seconds: float) -> None:
    """Write a recording of exactly that many seconds."""
    talk = recording(0, seconds=seconds + 10, seed=1)
    samples = np.resize(talk.samples, round(seconds * talk.rate))
    write_wav(path, samples, talk.rate)


def command(sound: Path, output: Path, bundle: Path) -> tuple[float, float, float]:
    """Wall seconds, processor seconds and peak MB of one `angie animate`."""
    line = [sys.executable, "-m", "angie", "animate", str(PHOTO), str(sound), "-o", str(output)]
    begun = time.perf_counter()
    child = subprocess.Popen([*line, "--speaker", str(bundle), "--force"], stdout=subprocess.PIPE)
    _, status, used = os.wait4(child.pid, 0)
    if status:
        raise SystemExit(f"angie animate failed with {status}")
    wall = time.perf_counter() - begun
    return wall, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


def lengths(folder: Path, bundle: Path, seconds: list[float]) -> None:
    """Animate recordings of several lengths."""
    sound, output = folder / "speech.wav", folder / "out.mp4"
    for name, length in (("frame", 1 / FPS), ("second", 1.0)):
        speech(sound, length)
        shortest = min(command(sound, output, bundle)[0] for _ in range(4))
        print(f"One {name} takes {shortest:.2f} s from the shell and back.")
    print()
    print("| sound, s | whole command, s | video s / s | processor, s | peak memory, MB | ratio |")
    print("|---|---|---|---|---|---|")
    first = 0.0
    for length in seconds:
        speech(sound, length)
        wall, worked, peak = command(sound, output, bundle)
        first = first or peak
        print(
            f"| {length:g} | {wall:.1f} | {length / wall:.2f} | {worked:.1f} "
            f"| {peak:.0f} | {peak / first:.3f} |",
            flush=True,
        )


def drawing(bundle: Bundle, folder: Path) -> None:
    """Draw frames alone and with the encoder beside; encode alone."""
    renderer = bundle.renderer()
    photo = read_photo(PHOTO)
    crop = speaker_crop(find_faces(photo)[0], *photo.shape[:2])
    picture = from_pixels(torch.from_numpy(cut_out(photo, crop))[None])
    pose = source_pose(renderer, picture)
    sway = 0.05 * torch.sin(torch.arange(FRAMES) / 8)[:, None, None]
    motion = Motion(pose.shift + sway, pose.cholesky.expand(FRAMES, -1, -1))
    size = (IMAGE_SIZE, IMAGE_SIZE)
    alone, beside, encoding = [], [], []
    for _ in range(ROUNDS + 1):
        begun = time.perf_counter()
        frames = np.concatenate(list(render(renderer, picture, pose, motion)))
        alone.append(time.perf_counter() - begun)
        begun = time.perf_counter()
        video = VideoWriter(folder / "beside.mp4", size, FPS, threads=1)
        with video, WriteThread(video) as encoder:
            for batch in render(renderer, picture, pose, motion):
                encoder.write(batch)
        beside.append(time.perf_counter() - begun)
        worked = time.process_time()
        with VideoWriter(folder / "alone.mp4", size, FPS, threads=1) as video:
            for frame in frames:
                video.write(frame)
        encoding.append(time.process_time() - worked)
    drawn, both, coded = (1000 * min(t[1:]) / FRAMES for t in (alone, beside, encoding))
    print("\n| ms a frame | |\n|---|---|")
    print(f"| drawing alone | {drawn:.1f} ({1000 / drawn:.1f} fps) |")
    print(f"| drawing, conversion and encoding side by side | {both:.1f} ({1000 / both:.1f} fps) |")
    print(f"| conversion and encoding, processor time | {coded:.2f} |")
    print(f"| slower by, in parts of that time | {(both - drawn) / coded:.2f} |")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--speaker", type=Path, default=BUNDLE)
    parser.add_argument("--seconds", type=float, nargs="*", default=[10.0, 60.0, 600.0])
    arguments = parser.parse_args()
    keep_memory()
    with tempfile.TemporaryDirectory() as name:
        lengths(Path(name), arguments.speaker, arguments.seconds)
        drawing(Bundle.open(arguments.speaker), Path(name))


if __name__ == "__main__":
    main()
