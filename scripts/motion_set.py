"""A phantom dataset for the motion side alone: sound, words, features and region motion, no frames.

    python scripts/motion_set.py WORK [--bundle BUNDLE] [--takes 58] [--seed 1]

The takes are those of `angie phantom --minutes 116 --seed 1` (see prove_motion.sh), 30 s of each of
four presenters a number, drawn and looked at without a video between: 20 ms a frame in place of 60.
WORK/set is the dataset, without frames and videos; WORK/base a bundle with the renderer of BUNDLE
(the shipped one), its statistics, and the motion of all clips, so that `angie train WORK/set -o
WORK/base --resume --generator NAME` goes on from there. WORK/truth has the strokes of each take.
Run again, it goes on; with fewer --takes than there are it makes the set of those.
"""

import argparse
import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import soxr
import torch

from angie.bundle import BUNDLE, Bundle
from data_prep.dataset import MANIFEST, TABLE, Clip, Dataset, write_table
from data_prep.errors import call_script
from data_prep.files import whole_file
from data_prep.media.audio import write_wav
from data_prep.phantom.make import Take, take, truth
from data_prep.phantom.presenters import presenter
from data_prep.prepare.clips import clip_bounds, piece_of_sound
from data_prep.prepare.split import split_clips
from data_prep.progress import progress
from data_prep.rates import FPS, IMAGE_SIZE, SAMPLE_RATE, SAMPLES_PER_FRAME
from data_prep.speaker.crop import cut_out, find_faces, median_face, speaker_crop
from data_prep.speech.features import Speech, write_features
from data_prep.speech.words import Word, slice_words, write_words
from mraa.extract import measure_motion
from mraa.motion import read_motion, write_motion
from mraa.regions import RegionEstimator

PRESENTERS = 4
LOOKS = 8
"""Frames of a take in which the face is looked for."""


def main() -> None:
    """Make the takes that are missing, then the dataset of all."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("work", type=Path)
    parser.add_argument("--bundle", type=Path, default=BUNDLE)
    parser.add_argument("--takes", type=int, default=58, help="of each presenter")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    source = Bundle.open(options.bundle)
    estimator = source.renderer().estimator
    for folder in ("audio", "features", "words"):
        (options.work / "set" / folder).mkdir(parents=True, exist_ok=True)
    for folder in ("truth", "motion"):
        (options.work / folder).mkdir(exist_ok=True)
    clips = []
    with progress("takes", options.takes * PRESENTERS, "takes") as advance:
        for number in range(options.takes):
            for index in range(PRESENTERS):
                clips += made(options.work, estimator, index, number, options.seed)
                advance()
    finish(options.work, source, clips)
    print(
        f"{options.work}: {len(clips)} clips, {sum(c.n_frames for c in clips) / FPS / 60:.1f} min"
    )


def made(work: Path, estimator: RegionEstimator, index: int, number: int, seed: int) -> list[Clip]:
    """The clips of a take, whose files are made unless they are there."""
    who = presenter(index, seed).name
    name = f"{who}_{number:03d}"
    done = work / "truth" / f"{name}.json"
    if not done.is_file():
        shot = take(index, number, seconds=30.0, seed=seed)
        bounds = write_take(work, name, shot, estimator)
        kept = {k: v for k, v in truth(shot, seed).items() if k.startswith(("stroke", "beats"))}
        with (
            whole_file(work / "truth" / f"{name}.npz", force=True) as part,
            part.open("wb") as file,
        ):
            np.savez(file, **kept)  # type: ignore[arg-type]
        with whole_file(done, force=True) as part:
            part.write_text(json.dumps(bounds))
    bounds = json.loads(done.read_text())
    return [
        Clip(f"{name}_{i:03d}", who, "", name, first / FPS, last - first)
        for i, (first, last) in enumerate(bounds)
    ]


def write_take(
    work: Path, name: str, shot: Take, estimator: RegionEstimator
) -> list[tuple[int, int]]:
    """Write sound, words, features and motion of a take's clips; their first and last frames."""
    frames = shot.joints.frames
    samples = soxr.resample(shot.speech.samples, shot.speech.rate, SAMPLE_RATE).astype(np.float32)
    samples = np.clip(piece_of_sound(samples, 0, frames), -1, 1)
    looked = [shot.figure.frame(int(t)) for t in np.linspace(0, frames - 1, LOOKS)]
    faces = [max(found, key=lambda f: f.h) for found in map(find_faces, looked) if found]
    height, width = looked[0].shape[:2]
    square = speaker_crop(median_face(faces), height, width)
    pictures = (cut_out(shot.figure.frame(t), square) for t in range(frames))
    motion = measure_motion(estimator, pictures)
    words = [Word(w.word, w.start, w.end) for w in shot.speech.words]
    bounds = clip_bounds(samples, frames)
    for i, (first, last) in enumerate(bounds):
        piece = samples[first * SAMPLES_PER_FRAME : last * SAMPLES_PER_FRAME]
        clip = f"{name}_{i:03d}"
        write_wav(work / "set" / "audio" / f"{clip}.wav", piece, SAMPLE_RATE)
        write_features(work / "set" / "features" / f"{clip}.npz", Speech(piece))
        inside = slice_words(words, first / FPS, last / FPS)
        write_words(work / "set" / "words" / f"{clip}.json", inside)
        write_motion(work / "motion" / f"{clip}.npz", motion[first:last])
    return bounds


def finish(work: Path, source: Bundle, clips: list[Clip]) -> None:
    """Write the dataset's table and the bundle, whose motion is told to be of both."""
    data, base = work / "set", work / "base"
    divided = split_clips(clips)
    manifest = {
        "format": 2, "fps": FPS, "size": IMAGE_SIZE, "sample_rate": SAMPLE_RATE,
        "splits": divided.rules, "sources": [],
    }  # fmt: skip
    (data / MANIFEST).write_text(json.dumps(manifest, indent=1))
    write_table(data / TABLE, divided.clips, FPS)
    if not (base / "bundle.json").is_file():
        shutil.copytree(source.folder, base, dirs_exist_ok=True)
    bundle = Bundle.open(base)
    bundle.name_regions()
    bundle.write()
    identity, folder = bundle.motion_identity(Dataset(data).digest), bundle.train / "motion"
    folder.mkdir(parents=True, exist_ok=True)
    for clip in divided.clips:
        motion = read_motion(work / "motion" / f"{clip.id}.npz")[: clip.n_frames]
        write_motion(folder / f"{clip.id}.npz", motion, identity)


if __name__ == "__main__":
    torch.set_num_threads(1)
    call_script(main)
