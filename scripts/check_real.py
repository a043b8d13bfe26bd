"""Train the renderer on the first seconds of a real video and reconstruct the rest.

    python scripts/check_real.py VIDEO WORK [--until 15] [--steps 300,600,1200] [--from BUNDLE]
        [--minutes 30] [key=value ...]

The video is cut in two at `--until` seconds, both parts are cropped alike and prepared; a `lite`
renderer is trained from nothing on the first part alone, or that of a bundle (`--from shipped` for
the package's own) is trained on with its regions frozen. After each number of steps every tenth
frame of the second part is drawn from the first frame of its clip (MRAA's protocol), and compared
with showing that first frame throughout. Prints the curve, writes a sheet of the last state to
WORK/reconstruction.png: source, truth, prediction for frames spread over the second part. Run
again, it goes on where it was. With --minutes it ends before the training would take longer.
"""

import argparse
import itertools
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import torch

from angie.bundle import BUNDLE, Bundle
from angie.config import parse_overrides, preset
from angie.training import train
from data_prep.dataset import TABLE, Dataset, write_table
from data_prep.media.audio import read_sound
from data_prep.media.video import VideoWriter, read_frames
from data_prep.prepare.prepare import prepare
from data_prep.prepare.source import IngestionConfig
from data_prep.rates import FPS, SAMPLE_RATE
from data_prep.speaker.crop import Crop, find_people, speaker_crop
from mraa.reconstruction import reconstruct
from mraa.renderer import Renderer, from_pixels, to_pixels
from mraa.training.run import RunConfig, native_precision

SHOWN = 12
"""Frames on the sheet."""


def cut_in_two(video: Path, work: Path, until: float) -> Crop:
    """Write WORK/first.mp4 and WORK/second.mp4 with their sound; the crop found in frame 0."""
    sound = read_sound(video)
    frames = read_frames(video)
    start = next(frames)
    height, width = start.shape[0] // 2 * 2, start.shape[1] // 2 * 2
    border = round(until * SAMPLE_RATE)
    count = round(until * FPS)
    everything = itertools.chain([start], frames)
    parts = (
        ("first", itertools.islice(everything, count), sound[:border]),
        ("second", everything, sound[border:]),
    )
    for name, part, samples in parts:
        path = work / f"{name}.mp4"
        with VideoWriter(path, (width, height), sound=(samples, SAMPLE_RATE), crf=10) as file:
            for frame in part:
                file.write(np.ascontiguousarray(frame[:height, :width]))
    return speaker_crop(find_people(start)[0], height, width)


def make_dataset(work: Path, part: str, crop: Crop) -> None:
    """Prepare one part; all of its clips become training clips."""
    prepare([work / f"{part}.mp4"], work / part, config=IngestionConfig(crop=crop))
    clips = [replace(clip, split="train") for clip in Dataset(work / part).clips()]
    write_table(work / part / TABLE, clips, FPS)


@torch.no_grad()
def write_reconstructions(path: Path, renderer: Renderer, dataset: Dataset) -> None:
    """Rows of source, truth and prediction, as one PNG."""
    rows = []
    clips = dataset.clips()
    for clip in clips:
        store = dataset.frames(clip)
        source = from_pixels(torch.from_numpy(store[0])[None])
        regions = renderer.estimator(source)
        for i in np.linspace(0, len(store) - 1, SHOWN // len(clips) + 1)[1:].astype(int):
            driving = from_pixels(torch.from_numpy(store[int(i)])[None])
            background = renderer.background(source, driving)
            made, _ = renderer(source, regions, renderer.estimator(driving), background)
            row = [store[0], store[int(i)], to_pixels(made)[0].numpy()]
            rows.append(np.concatenate(row, axis=1))
    half = (len(rows) + 1) // 2
    rows += [np.zeros_like(rows[0])] * (2 * half - len(rows))
    sheet = np.concatenate([np.concatenate(rows[:half]), np.concatenate(rows[half:])], axis=1)
    path.write_bytes(cv2.imencode(".png", cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR))[1].tobytes())


def main() -> None:
    """Print the curve as a table in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("video", type=Path)
    parser.add_argument("work", type=Path)
    parser.add_argument("settings", nargs="*")
    parser.add_argument("--until", type=float, default=15.0)
    parser.add_argument("--steps", default="300,600,1200")
    parser.add_argument("--from", dest="origin", help="bundle to train on, or shipped")
    parser.add_argument("--minutes", type=float, default=float("inf"))
    given = parser.parse_intermixed_args()
    given.work.mkdir(exist_ok=True)
    if not (given.work / "second" / TABLE).exists():
        crop = cut_in_two(given.video, given.work, given.until)
        for part in ("first", "second"):
            make_dataset(given.work, part, crop)
    first, second = given.work / "first", Dataset(given.work / "second")
    print(
        "| steps | L1 | PSNR | L1 of the source | PSNR of the source | gain |\n" + "|---" * 6 + "|"
    )
    origin = BUNDLE if given.origin == "shipped" else given.origin and Path(given.origin)
    begun, spent, done = time.monotonic(), 0.0, 0
    for steps in map(int, given.steps.split(",")):
        if done and spent * steps / done > 60 * given.minutes:
            print(f"{spent / 60:.1f} minutes of training; {steps} steps would take too long")
            break
        changes = parse_overrides([*given.settings, f"train_renderer.steps={steps}"])
        bundle = train(
            first,
            given.work / "bundle",
            preset=None if origin else preset("lite"),
            changes=changes,
            stage="renderer",
            resume=True,
            origin=None if (given.work / "bundle" / "bundle.json").exists() else origin,
            run=RunConfig(device="cpu", precision=native_precision("cpu")),
        )
        spent, done = spent + time.monotonic() - begun, steps
        renderer = Bundle.open(bundle.folder).renderer()
        score = reconstruct(renderer, second, second.clips())
        cells = [f"{score.l1:.4f}", f"{score.psnr:.2f}", f"{score.copy_l1:.4f}"]
        cells += [f"{score.copy_psnr:.2f}", f"{score.psnr - score.copy_psnr:+.2f} dB"]
        print(f"| {steps} | " + " | ".join(cells) + " |", flush=True)
        write_reconstructions(given.work / "reconstruction.png", renderer, second)
        begun = time.monotonic()


if __name__ == "__main__":
    main()
