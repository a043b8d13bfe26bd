"""Frames of a video side by side: the picture at the head of the README.

    python scripts/strip.py VIDEO OUT.jpg [--frames 0,48,136,...] [--height 256]

Frames are counted at 25 a second, from 0.
"""

import argparse
from pathlib import Path

import cv2
import imageio.v3 as imageio
import numpy as np

from data_prep.errors import BadInput, call_script
from data_prep.files import whole_file
from data_prep.media.video import read_frames


def strip(video: Path, wanted: list[int], height: int) -> np.ndarray:
    """The frames named by their numbers, in one row `(height, W, 3)` uint8.

    Raises:
        BadInput: a frame that the video does not have.
    """
    parts = [(k, k + 1) for k in sorted(set(wanted))]
    frames = dict(zip(sorted(set(wanted)), read_frames(video, wanted=parts), strict=False))
    if missing := set(wanted) - set(frames):
        raise BadInput(f"--frames {min(missing)}: {video} has fewer frames")
    width = round(height * next(iter(frames.values())).shape[1] / len(next(iter(frames.values()))))
    scaled = [cv2.resize(frames[k], (width, height), interpolation=cv2.INTER_AREA) for k in wanted]
    return np.concatenate(scaled, axis=1)


def main() -> None:
    """Write the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("video", type=Path)
    parser.add_argument("picture", type=Path)
    parser.add_argument("--frames", default="0,50,100,150,200,250", help="numbers, with commas")
    parser.add_argument("--height", type=int, default=256, help="of a frame, in pixels")
    given = parser.parse_args()
    try:
        wanted = [int(text) for text in given.frames.split(",")]
    except ValueError:
        raise BadInput(f"--frames {given.frames}: give numbers of frames, such as 0,50") from None
    picture = strip(given.video, wanted, given.height)
    with whole_file(given.picture, force=True) as part:
        imageio.imwrite(part, picture, extension=given.picture.suffix, quality=90)


if __name__ == "__main__":
    call_script(main)
