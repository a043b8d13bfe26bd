"""Backgrounds to put keyed people before, packed; see `mraa.training.backgrounds`.

    python scripts/draw_backgrounds.py ARCHIVE [--sheet SHEET.png [--keyed VIDEO]]

Writes ARCHIVE/backgrounds.npz, `jpeg` object-free: one array of bytes and the end of each. SHEET
shows all of them, or with --keyed a person before a blue screen put before 24 of them, to look at.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np

from data_prep.errors import BadInput, call_script
from data_prep.media.video import read_frames
from data_prep.speaker.crop import cut_out, find_people, speaker_crop
from mraa.training.backgrounds import Screen, bank, exchanged

SHOWN = 24
"""Pictures on a sheet of a keyed person."""


def keyed(video: Path) -> list[np.ndarray]:
    """A person of a video before other backgrounds.

    Raises:
        BadInput: nobody, or no blue screen.
    """
    frames = list(read_frames(video))
    people = find_people(frames[0])
    if not people:
        raise BadInput(f"{video}: shows no person")
    crop = speaker_crop(people[0], *frames[0].shape[:2])
    screen = Screen(cut_out(frames[0], crop))
    if not screen.there:
        raise BadInput(f"{video}: shows no blue screen")
    chosen = [frames[i] for i in np.linspace(0, len(frames) - 1, SHOWN).astype(int)]
    made = []
    for number, frame in enumerate(chosen):
        pair = np.stack([cut_out(frame, crop)] * 2)
        made.append(exchanged(pair, screen, np.random.default_rng(number))[0])
    return made


def main() -> None:
    """Write the bank."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("archive", type=Path)
    parser.add_argument("--sheet", type=Path)
    parser.add_argument("--keyed", type=Path, help="video of a person before a blue screen")
    given = parser.parse_args()
    quality = [cv2.IMWRITE_JPEG_QUALITY, 85]
    coded = [cv2.imencode(".jpg", image[:, :, ::-1], quality)[1] for image in bank()]
    ends = np.cumsum([len(c) for c in coded])
    given.archive.mkdir(parents=True, exist_ok=True)
    np.savez(given.archive / "backgrounds.npz", jpeg=np.concatenate(coded).ravel(), ends=ends)
    print(f"{len(coded)} backgrounds, {ends[-1] / 2**20:.1f} MiB")
    if given.sheet:
        shown = keyed(given.keyed) if given.keyed else bank()
        whole = len(shown) // 8 * 8
        lines = [np.concatenate(shown[i : i + 8], 1) for i in range(0, whole, 8)]
        cv2.imwrite(str(given.sheet), np.ascontiguousarray(np.concatenate(lines)[..., ::-1]))


if __name__ == "__main__":
    call_script(main)
