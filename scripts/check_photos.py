"""Animate photos, and say what is left of the people in them.

    python scripts/check_photos.py PHOTOS --models FOLDER [--bundle B] [--voice RECORDING]
        [--amplitude 1 0.7 0.5] [--sheets FOLDER]

PHOTOS is a folder of photos (or several photos), FOLDER holds MediaPipe's networks. Every photo is
animated to the recording (one of the package's own by default), and 12 frames spread over its
first seconds are looked at, at twice the size, once for each amplitude:

    hands   of the hands that a hand network sees in the photo's own square (score over 0.5 at a
            wrist that a body network sees), the share that is seen in a frame, wherever it is now;
            one whose wrist has left the picture does not count, one that is lost counts as 0
    face    likeness of the face to the photo's (`angie.evaluation.definitions`), 0 for a lost one
    motion  mean distance of the wrists from where they are in the photo, in shoulder widths

    learnt  whether the photo is unlike the people that the model has learnt (`--amplitude`'s note)

Photos without a person, or that `angie animate` refuses, are named and left out. The last line of
each amplitude pools all hands and all faces. With --sheets a picture of the photo and its 12 frames
is written for every photo and amplitude.
"""

import argparse
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import torch

from angie.bundle import BUNDLE, SPEECH
from angie.evaluation.images import pick
from angie.evaluation.people import TWICE, PeopleJudge, enlarged
from angie.pipeline import GesturePipeline
from angie.source import View
from data_prep.errors import BadInput, call_script
from data_prep.rates import FPS, IMAGE_SIZE
from data_prep.speaker.people import SEEN, SHOULDERS, WRISTS, Pose
from mraa.draw import render, source_pose
from mraa.renderer import to_pixels

SHOWN = 12
"""Frames that are looked at."""

ENDINGS = {".jpg", ".jpeg", ".png", ".webp"}


@dataclass
class Row:
    """What was found in the frames of one photo, or of all."""

    hands: list[float] = field(default_factory=list)
    faces: list[float] = field(default_factory=list)
    moved: list[float] = field(default_factory=list)

    def __str__(self) -> str:
        hands = f"{np.mean(self.hands):.2f} of {len(self.hands)}" if self.hands else "none"
        face = f"{np.mean(self.faces):.3f}" if self.faces else "none"
        return (
            f"{hands} | {face} | {np.mean(self.moved):.2f}"
            if self.moved
            else f"{hands} | {face} | -"
        )


def hand_scores(judge: PeopleJudge, large: np.ndarray, pose: Pose) -> list[float | None]:
    """Score of each hand whose wrist lies in the picture, 0 where the wrist is not seen."""
    scores: list[float | None] = []
    for side, square in enumerate(judge.people.hand_squares(pose)):
        wrist = pose.points[WRISTS[side]]
        if not ((wrist > 0) & (wrist < TWICE * IMAGE_SIZE)).all():
            scores.append(None)
        else:
            scores.append(0.0 if square is None else judge.people.hand(large, square).score)
    return scores


def look(judge: PeopleJudge, photo: np.ndarray, frames: np.ndarray) -> Row:
    """What is left in frames (n, H, W, 3) uint8 of the person of a photo (H, W, 3) uint8."""
    row, large = Row(), enlarged(photo)
    judge.people.forget()
    own, face = judge.people.pose(large), judge.likeness(large)
    if own is None:
        return row
    wanted = hand_scores(judge, large, own)
    width = np.linalg.norm(np.subtract(*own.points[list(SHOULDERS)]))
    for frame in map(enlarged, frames):
        pose = judge.people.pose_at(frame, own.body)
        for before, score in zip(wanted, hand_scores(judge, frame, pose), strict=True):
            if before is not None and before > SEEN and score is not None:
                row.hands.append(float(score > SEEN))
        if face is not None:
            made = judge.likeness(frame)
            row.faces.append(0.0 if made is None else float(made @ face))
        way = pose.points[list(WRISTS)] - own.points[list(WRISTS)]
        row.moved.append(float(np.linalg.norm(way, axis=-1).mean() / width))
    return row


def photos(places: list[Path]) -> list[Path]:
    """The photos that are given, and those of folders.

    Raises:
        BadInput: there are none.
    """
    found = [q for p in places for q in (sorted(p.iterdir()) if p.is_dir() else [p])]
    kept = [path for path in found if path.suffix.lower() in ENDINGS]
    if not kept:
        raise BadInput(f"{places[0]}: holds no photos")
    return kept


def main() -> None:
    """Print the table in Markdown."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("photos", type=Path, nargs="+")
    parser.add_argument("--models", type=Path, required=True)
    parser.add_argument("--bundle", type=Path, default=BUNDLE)
    parser.add_argument("--voice", type=Path, default=SPEECH)
    parser.add_argument("--amplitude", type=float, nargs="+", default=[1.0])
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--sheets", type=Path)
    given = parser.parse_args()
    paths, judge = photos(given.photos), PeopleJudge(given.models)
    pipe = GesturePipeline.from_pretrained(given.bundle, precision="fp32")
    speech = pipe.speech(given.voice)
    last = min(speech.frames, round(given.seconds * FPS)) - 1
    numbers = np.linspace(0, last, SHOWN + 1)[1:].astype(int)
    pooled = {amplitude: Row() for amplitude in given.amplitude}
    print("| photo | amplitude | hands | face | motion | learnt |\n" + "|---" * 6 + "|")
    for path in paths:
        view = View(person="largest")
        for amplitude, whole in pooled.items():
            try:
                video = pipe(
                    path, given.voice, seed=given.seed, speech=speech, amplitude=amplitude,
                    view=view,
                )  # fmt: skip
                view = View(crop=video.crop)  # found once
            except BadInput as error:
                print(f"{error}; left out", flush=True)
                break
            picture, motion = video.subject.picture, video.motion
            assert motion is not None
            pose = source_pose(pipe.renderer, picture)
            with torch.no_grad():
                chosen = pick(motion, numbers)
                drawn = np.concatenate(list(render(pipe.renderer, picture, pose, chosen, "fp32")))
            photo = to_pixels(picture)[0].numpy()
            row = look(judge, photo, drawn)
            for name, values in vars(row).items():
                getattr(whole, name).extend(values)
            unlike = "unlike" if "unlike" in video.note else ""
            print(f"| {path.stem} | {amplitude:g} | {row} | {unlike} |", flush=True)
            if given.sheets:
                given.sheets.mkdir(exist_ok=True)
                cells = [photo, *drawn, np.zeros_like(photo)]
                half = len(cells) // 2
                lines = [np.concatenate(part, 1) for part in (cells[:half], cells[half:])]
                sheet = np.concatenate(lines)[..., ::-1]
                name = f"{path.stem}-{amplitude:g}.png"
                cv2.imwrite(str(given.sheets / name), np.ascontiguousarray(sheet))
    for amplitude, whole in pooled.items():
        print(f"| **all** | {amplitude:g} | {whole} | |")


if __name__ == "__main__":
    call_script(main)
