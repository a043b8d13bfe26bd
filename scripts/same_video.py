"""Whether two versions of angie make the same motion and the same frames.

    python scripts/same_video.py OLD NEW [--psnr DB] [--pixels P] [--keep FOLDER]

OLD and NEW each name a version: a Python executable of an environment where it is installed, a
checkout (run by this Python), or PYTHON=CHECKOUT. Both run `angie gestures` and `angie animate` on
three inputs: the photo and the recording that ship with OLD; a frame and the sound of a phantom
video that OLD makes; that frame with the recording that ships, another seed and 512 pixels.

For each input it compares the arrays of motion and the decoded frames. Without bounds all must be
equal bit for bit; `--psnr` and `--pixels` say how far frames and region centres (in pixels of 256)
may be apart. Frames have been through H.264 on both sides, which adds errors of its own once they
are not equal. Exit status 1 where a bound is broken.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path

import imageio.v3 as imageio
import numpy as np

from data_prep.errors import BadInput, call_script
from data_prep.media.video import read_frames
from data_prep.rates import IMAGE_SIZE

PIXEL = IMAGE_SIZE / 2
"""Pixels in one unit of coordinates in [-1, 1]."""

STILL = 60
"""The frame of the phantom video that serves as a photo."""


@dataclass(frozen=True)
class Version:
    """A version of angie: the Python that runs it, and its checkout unless it is installed."""

    python: str
    checkout: Path | None

    @classmethod
    def parse(cls, text: str) -> "Version":
        """Read PYTHON, CHECKOUT or PYTHON=CHECKOUT."""
        python, _, folder = text.rpartition("=")
        if not python and not Path(folder).is_dir():
            return cls(folder, None)
        if not (Path(folder) / "angie").is_dir():
            raise BadInput(f"{text}: {folder} is no checkout of angie; name the folder above angie")
        return cls(python or sys.executable, Path(folder).resolve())

    def run(self, *arguments: str | Path, folder: Path) -> str:
        """Standard output of `python ARGUMENTS`, run in a folder that holds no package."""
        environment = {key: text for key, text in os.environ.items() if key != "PYTHONPATH"}
        if self.checkout is not None:
            environment["PYTHONPATH"] = str(self.checkout)
        line = [self.python, *map(str, arguments)]
        try:
            done = subprocess.run(line, env=environment, cwd=folder, capture_output=True, text=True)
        except OSError as error:
            raise BadInput(f"{self.python}: {error.strerror}; name a Python executable") from error
        if done.returncode:
            raise BadInput(f"{' '.join(line)}: {done.stderr.strip().splitlines()[-1:]}")
        return done.stdout

    def shipped(self, folder: Path) -> Path:
        """The folder with the photo, the recording and the bundle that ship."""
        code = "import angie; print(angie.__path__[0])"
        return Path(self.run("-c", code, folder=folder).strip()) / "default"


@dataclass(frozen=True)
class Input:
    """One photo and one recording, and the options of the two commands."""

    name: str
    photo: Path
    sound: Path
    seed: int
    options: tuple[str, ...] = ()

    def make(self, version: Version, folder: Path) -> tuple[Path, Path]:
        """Motion (.npz) and video (.mp4) of one version."""
        motion, video = folder / f"{self.name}.npz", folder / f"{self.name}.mp4"
        seed = ("--seed", str(self.seed))
        bundle = version.shipped(folder) / "bundle"
        angie = ("-m", "angie")
        version.run(*angie, "gestures", bundle, self.sound, "-o", motion, *seed, folder=folder)
        version.run(
            *angie, "animate", self.photo, self.sound, "-o", video, *seed, *self.options,
            folder=folder,
        )  # fmt: skip
        return motion, video


def inputs(version: Version, folder: Path) -> list[Input]:
    """The three inputs; what does not ship is made by a version."""
    shipped = version.shipped(folder)
    photo, speech = shipped / "photo.png", shipped / "speech.flac"
    phantom = ("phantom", "-o", "raw", "--minutes", "0.2", "--presenters", "1", "--seed", "5")
    version.run("-m", "angie", *phantom, folder=folder)
    talk = min((folder / "raw").rglob("*.mp4"))
    still = folder / "still.png"
    imageio.imwrite(still, next(read_frames(talk, wanted=[(STILL, STILL + 1)])))
    return [
        Input("shipped", photo, speech, seed=0),
        Input("phantom", still, talk, seed=1),
        Input("large", still, speech, seed=2, options=("--size", "512")),
    ]


def motion_apart(old: Path, new: Path) -> tuple[float, float]:
    """Largest difference of any array, and of region centres in pixels; infinite: other shapes."""
    with np.load(old) as a, np.load(new) as b:
        if set(a.files) != set(b.files) or any(a[k].shape != b[k].shape for k in a.files):
            return np.inf, np.inf
        apart = {k: float(np.abs(a[k].astype(np.float64) - b[k]).max()) for k in a.files}
    return max(apart.values()), apart["shift"] * PIXEL


def frames_apart(old: Iterator[np.ndarray], new: Iterator[np.ndarray]) -> tuple[int, float]:
    """Largest difference in grey levels, and PSNR of all frames; 255 and -inf: other sizes."""
    largest, squares, count = 0, 0.0, 0
    for a, b in zip_longest(old, new):
        if a is None or b is None or a.shape != b.shape:
            return 255, -np.inf
        apart = a.astype(np.int64) - b
        largest = max(largest, int(np.abs(apart).max()))
        squares, count = squares + float((apart**2).sum()), count + apart.size
    return largest, float(10 * np.log10(255**2 * count / squares)) if squares else np.inf


def compare(given: argparse.Namespace, folder: Path) -> bool:
    """Print a row for each input; whether all of them are within the bounds."""
    versions = [Version.parse(given.old), Version.parse(given.new)]
    folders = [folder / "old", folder / "new"]
    for each in folders:
        each.mkdir(parents=True)
    print(f"{'input':10}{'frames':>8}{'motion':>12}{'pixels':>10}{'grey':>6}{'PSNR':>10}")
    within = True
    for one in inputs(versions[0], folder):
        made = [one.make(v, f) for v, f in zip(versions, folders, strict=True)]
        (motion, pixels), (grey, psnr) = (
            motion_apart(made[0][0], made[1][0]),
            frames_apart(read_frames(made[0][1]), read_frames(made[1][1])),
        )
        frames = sum(1 for _ in read_frames(made[1][1]))
        print(f"{one.name:10}{frames:8}{motion:12.3g}{pixels:10.3g}{grey:6}{psnr:10.2f}")
        within &= motion == 0 if given.pixels is None else pixels <= given.pixels
        within &= grey == 0 if given.psnr is None else psnr >= given.psnr
    return within


def main() -> None:
    """Compare two versions on three inputs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("old", help="Python executable, checkout, or PYTHON=CHECKOUT")
    parser.add_argument("new", help="the same of the version to compare")
    parser.add_argument("--psnr", type=float, metavar="DB", help="least PSNR of the frames")
    parser.add_argument("--pixels", type=float, help="how far a region may move, of 256")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="new folder for what is made")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        folder = given.keep or Path(place) / "videos"
        if folder.exists():
            raise BadInput(f"{folder}: is there already; name a new folder")
        within = compare(given, folder.resolve())
    print("equal, or within the bounds" if within else "not equal, or outside the bounds")
    sys.exit(not within)


if __name__ == "__main__":
    call_script(main)
