"""Motion of joints in place of regions: any (T, J, 2) arrays with their sound.

Papers compare skeletons (ANGIE's Tables 1 and 2, section 4.2). The same generators then work on
shifts alone, without the regions' extent. The layout::

    clips.csv             clip,speaker,split,fps     split is train, val or test; fps of the motion
    motion/<clip>.npy     (T, J, 2) float, one row a frame; or .npz with `points`
    audio/<clip>.wav      the sound, of the same beginning; any format that can be read
    audio/<clip>.json     what is said, if anybody reads words; any format that angie prepare reads

Coordinates may have any unit and origin; joints must be finite. Motion is resampled to 25 frames
a second for the models and comes back at any rate.
"""

import glob
import hashlib
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from angie.motion.clips import MotionClip
from data_prep.arrays import read_arrays
from data_prep.errors import BadInput
from data_prep.files import whole_file
from data_prep.media.audio import read_sound
from data_prep.rates import FPS
from data_prep.speech.features import FeatureFiles, Speech, write_features
from data_prep.speech.transcript import find_transcript, read_transcript
from data_prep.table import number, read_table
from mraa.motion import Motion

INDEX = "clips.csv"
COLUMNS = ("clip", "speaker", "split", "fps")
SPLITS = ("train", "val", "test")

NO_SOUND = (".TextGrid", ".json", ".txt", ".srt", ".vtt", ".ctm")
"""Endings of files that may lie beside a recording and are none."""

MOST = 1e15
"""Largest coordinate: training is in float32, where the squares of larger ones overflow."""


@dataclass(frozen=True)
class KeypointClip:
    """A row of the index.

    Attributes:
        id: name of the clip's files.
        speaker: name of the speaker.
        split: "train", "val" (to choose weights by; may be absent) or "test".
        fps: frames a second of the motion.
        n_frames: frames at 25 a second.
    """

    id: str
    speaker: str
    split: str
    fps: float
    n_frames: int


def resample(points: NDArray, fps: float, to: float) -> NDArray:
    """Motion (T, J, 2) at another rate, from the same first frame on.

    To a higher rate by cubic splines; to a lower one after a Gaussian of
    0.5 (fps / to - 1) frames, which is left out below 0.3, by linear interpolation.

    Args:
        points: (T, J, 2).
        fps: frames a second of `points`.
        to: frames a second wanted.

    Returns:
        (T', J, 2), the frames at multiples of 1 / to up to the last one of `points`.
    """
    if fps == to or len(points) < 2:
        return points
    times = np.arange(len(points)) / fps
    wanted = np.arange(int(np.floor(times[-1] * to + 1e-6)) + 1) / to
    if to > fps:
        return CubicSpline(times, points)(wanted)
    sigma = 0.5 * (fps / to - 1)
    smooth = gaussian_filter1d(points, sigma, axis=0, mode="nearest") if sigma >= 0.3 else points
    flat = smooth.reshape(len(points), -1)
    columns = [np.interp(wanted, times, column) for column in flat.T]
    return np.stack(columns, axis=1).reshape(len(wanted), *points.shape[1:])


def _arrays(path: Path) -> dict[str, NDArray]:
    """`points` and `fps` of an .npz file, as far as it has them; the array of an .npy file.

    Raises:
        BadInput: unreadable.
    """
    try:
        arrays = read_arrays(path, ("points", "fps"))
    except ValueError as error:
        raise BadInput(f"{path}: not a readable array ({error})") from error
    return {"points": arrays[""]} if "" in arrays else arrays


def read_points(path: Path) -> NDArray:
    """Joints (T, J, 2) float64 of an .npy file, or of `points` in an .npz file.

    Raises:
        BadInput: unreadable, of another shape, or with numbers that are not finite in float32.
    """
    arrays = _arrays(path)
    if "points" not in arrays:
        raise BadInput(f"{path}: has no array `points`")
    points = arrays["points"]
    if points.ndim != 3 or points.shape[2] != 2 or not points.size:
        raise BadInput(f"{path}: holds {points.shape}, wanted are joints (T, J, 2)")
    if points.dtype.kind not in "fiu" or not np.isfinite(points).all():
        raise BadInput(f"{path}: every joint must be a finite number; fill gaps first")
    points = points.astype(np.float64)
    if np.abs(points).max() > MOST:
        raise BadInput(f"{path}: every joint must be a finite number in float32, up to {MOST:g}")
    return points


def read_rate(path: Path) -> float | None:
    """Frames a second that an .npz file states as `fps`, as `angie gestures` writes it; or None.

    Raises:
        BadInput: it is not a rate from 1 to 1000.
    """
    stated = _arrays(path).get("fps")
    if stated is None:
        return None
    fps = float(stated) if stated.size == 1 and stated.dtype.kind in "fiu" else 0.0
    if not 1 <= fps <= 1000:
        raise BadInput(f"{path}: fps {stated} is not a rate from 1 to 1000")
    return fps


class KeypointDataset:
    """Clips of joints with their sound.

    `cache`: where features of the sound are kept; made when needed.

    Raises:
        BadInput: an index that cannot be used, or files that it names and that are missing.
    """

    def __init__(self, path: Path, cache: Path) -> None:
        self.path, self.cache = Path(path), Path(cache)
        self._joints: dict[str, int] = {}
        self._clips = [self._clip(row) for row in read_table(self.path / INDEX, COLUMNS)]
        names = [clip.id for clip in self._clips]
        if len(set(names)) < len(names):
            raise BadInput(f"{self.path / INDEX}: names a clip twice")

    def _clip(self, row: dict[str, str]) -> KeypointClip:
        name, index = row["clip"], self.path / INDEX
        try:
            fps = number(row["fps"])
        except ValueError:
            fps = 0.0
        if not name or Path(name).name != name or row["split"] not in SPLITS or not row["speaker"]:
            wanted = f"a name, a speaker and {', '.join(SPLITS[:-1])} or {SPLITS[-1]}"
            raise BadInput(f"{index}: {name or 'a row'}: needs {wanted}")
        if not 1 <= fps <= 1000:
            raise BadInput(f"{index}: {name}: fps {row['fps']} is not a rate from 1 to 1000")
        points = read_points(self._motion_file(name))
        self._joints[name] = points.shape[1]
        frames = len(resample(points[:, :1], fps, FPS))
        return KeypointClip(name, row["speaker"], row["split"], fps, frames)

    def _motion_file(self, name: str) -> Path:
        for ending in (".npy", ".npz"):
            path = self.path / "motion" / f"{name}{ending}"
            if path.is_file():
                return path
        raise BadInput(f"{self.path}: motion/{name}.npy is missing")

    def _sound_file(self, name: str) -> Path:
        found = sorted((self.path / "audio").glob(f"{glob.escape(name)}.*"))
        paths = [
            path
            for path in found
            if path.stem == name and path.suffix not in NO_SOUND and path.is_file()
        ]
        if not paths:
            raise BadInput(f"{self.path}: audio/{name}.wav is missing")
        if len(paths) > 1:
            both = " and ".join(path.name for path in paths[:2])
            raise BadInput(f"{self.path}: audio holds {both}; leave one recording a clip")
        return paths[0]

    @cached_property
    def digest(self) -> str:
        """Hash of the index, of all motion, all recordings and all transcripts."""
        total = hashlib.sha256((self.path / INDEX).read_bytes())
        for clip in self._clips:
            sound = self._sound_file(clip.id)
            for path in (self._motion_file(clip.id), sound, find_transcript(sound)):
                total.update(b"" if path is None else path.read_bytes())
        return total.hexdigest()

    def clips(self, split: str | None = None) -> list[KeypointClip]:
        """Clips of a split, or all."""
        return [clip for clip in self._clips if split in (None, clip.split)]

    def speakers(self) -> list[str]:
        """Names of the speakers, sorted."""
        return sorted({clip.speaker for clip in self._clips})

    def joints(self) -> int:
        """Number of joints J, the same in every clip.

        Raises:
            BadInput: clips with different numbers of joints.
        """
        counts = self._joints
        if len(set(counts.values())) > 1:
            least, most = min(counts, key=counts.__getitem__), max(counts, key=counts.__getitem__)
            raise BadInput(
                f"{self.path}: {least} has {counts[least]} joints, {most} {counts[most]}"
            )
        return next(iter(counts.values()))

    def motion_clips(self, split: str) -> list[MotionClip]:
        """Motion at 25 frames a second and features of a split.

        Motion beyond the end of the sound is left out.
        """
        made = []
        for clip in self.clips(split):
            speech = self.speech(clip.id)
            points = resample(read_points(self._motion_file(clip.id)), clip.fps, FPS)
            kept = points[: speech.frames].astype(np.float32)
            motion = Motion.of_points(torch.from_numpy(kept))
            made.append(MotionClip(clip.id, clip.speaker, motion, speech))
        return made

    def sound(self, name: str) -> NDArray:
        """Sound (N,) of a clip, float32 mono at 16 kHz."""
        return read_sound(self._sound_file(name))

    def check_sound(self) -> None:
        """Read the recordings whose features are not kept yet.

        Raises:
            BadInput: one that cannot be read.
        """
        for clip in self._clips:
            if not self._kept(clip.id).is_file():
                self.sound(clip.id)

    def _kept(self, name: str) -> Path:
        """File of the features of a clip's sound, named after what the recording holds."""
        digest = hashlib.sha256(self._sound_file(name).read_bytes()).hexdigest()
        return self.cache / f"{digest[:32]}.npz"

    def speech(self, name: str) -> Speech:
        """The recording of a clip with its words and features; these are kept in `cache`.

        Raises:
            BadInput: a transcript that cannot be read.
        """
        kept = self._kept(name)
        if not kept.is_file():
            self.cache.mkdir(parents=True, exist_ok=True)
            with whole_file(kept, force=True) as part:
                write_features(part, Speech(self.sound(name)))
        store = FeatureFiles(kept)
        sound = partial(self.sound, name)
        path = find_transcript(self._sound_file(name))
        words = None
        if path is not None:
            transcript = read_transcript(path)
            words = transcript.aligned(sound()) if transcript.text else transcript.words
        return Speech(sound, words, frames=store.frames, store=store)
