"""A dataset folder: clips of speakers with frames, sound, features and words.

Frames of a clip as JPEG in one memory-mapped file, read in any order.
"""

import csv
import functools
import hashlib
import json
import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from safetensors import SafetensorError

from data_prep.errors import BadInput
from data_prep.media.audio import read_sound
from data_prep.media.container import check_file
from data_prep.rates import FPS, SAMPLES_PER_FRAME
from data_prep.speech.features import FeatureFiles, Speech
from data_prep.speech.words import Word, read_words, slice_words
from data_prep.table import number, read_table
from data_prep.tensors import open_tensors, save_tensors

MAX_BYTES = 25_000
"""Most that a frame takes on average."""

_QUALITIES = (92, 88, 84, 78, 70, 60)


def encode_frame(frame: np.ndarray) -> bytes:
    """JPEG of `(H, W, 3)` uint8 RGB, of the best quality that `MAX_BYTES` allows."""
    bgr = cv2.cvtColor(frame, cv2.COLOR_RGB2BGR)
    for quality in _QUALITIES:
        good, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, quality])
        if not good:
            raise RuntimeError(f"OpenCV could not encode a frame {frame.shape} as JPEG")
        if len(data) <= MAX_BYTES:
            break
    return data.tobytes()


def write_frames(path: Path, frames: Iterable[bytes]) -> None:
    """Write encoded frames: `jpeg (bytes,)` uint8 and `offset (T + 1,)` int64.

    Args:
        path: the safetensors file to write.
        frames: as `encode_frame` makes them.
    """
    parts = [np.frombuffer(frame, np.uint8) for frame in frames]
    offset = np.cumsum([0, *(len(part) for part in parts)], dtype=np.int64)
    save_tensors(path, {"jpeg": np.concatenate(parts), "offset": offset})


class FrameStore:
    """The frames of a clip; `store[i]` is frame i, `(H, W, 3)` uint8 RGB.

    The file is mapped, not read; an instance may be sent to other processes.
    """

    def __init__(self, path: Path, count: int | None = None) -> None:
        """Open the file.

        Args:
            path: as `write_frames` wrote it.
            count: frames of the clip, where the last ones in the file are left unused.

        Raises:
            BadInput: missing, damaged, or with fewer frames than `count`.
        """
        self.path, self.count = Path(path), count
        self._open()

    def _open(self) -> None:
        try:
            self._file = open_tensors(self.path, "numpy")
            self._jpeg = self._file.get_slice("jpeg")
            self._offset = self._file.get_tensor("offset")
        except (OSError, SafetensorError) as error:
            raise BadInput(f"{self.path}: damaged or missing; prepare the dataset again") from error
        stored = len(self._offset) - 1
        if self.count is not None and self.count > stored:
            raise BadInput(
                f"{self.path}: holds {stored} of {self.count} frames; prepare the dataset again"
            )
        self._frames = stored if self.count is None else self.count

    def __len__(self) -> int:
        """Number of frames."""
        return self._frames

    def __getitem__(self, index: int) -> np.ndarray:
        """Frame `index`; negative numbers count from the end."""
        if not -len(self) <= index < len(self):
            raise IndexError(f"frame {index} of {len(self)}")
        index %= len(self)
        data = self._jpeg[int(self._offset[index]) : int(self._offset[index + 1])]
        whole = bytes(data[-2:]) == b"\xff\xd9"  # else libjpeg writes to standard error
        frame = cv2.imdecode(np.asarray(data), cv2.IMREAD_COLOR) if whole else None
        if frame is None:
            raise BadInput(f"{self.path}: frame {index} is damaged; prepare the dataset again")
        return cv2.cvtColor(frame, cv2.COLOR_BGR2RGB)

    def __getstate__(self) -> dict[str, Path | int | None]:
        return {"path": self.path, "count": self.count}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.path, self.count = state["path"], state["count"]
        self._open()


FORMAT = 2
"""Version of the layout; a newer one is refused."""

MANIFEST = "dataset.json"
TABLE = "meta.csv"
COLUMNS = (
    "clip_id", "speaker", "split", "source", "start", "fps", "n_frames", "duration", "person",
)  # fmt: skip


@dataclass(frozen=True)
class Clip:
    """One clip.

    Attributes:
        id: name of its files.
        speaker: who speaks: whose way of gesturing it is.
        split: "train", "val" or "test".
        source: name of the video it was cut from.
        start: seconds from the first frame of that video.
        n_frames: frames at 25 fps. The files of a clip that is the last before another split
            hold more: what follows is the gap between the splits, and `Dataset` never gives it.
        person: who is seen, where that is another name than the speaker's; else empty. One face
            may gesture in several ways, and several faces in one.
    """

    id: str
    speaker: str
    split: str
    source: str
    start: float
    n_frames: int
    person: str = ""

    @property
    def face(self) -> str:
        """Name of who is seen."""
        return self.person or self.speaker


def write_table(path: Path, clips: list[Clip], fps: int) -> None:
    """Write `meta.csv`, one row for each clip, ordered by clip id; it appears whole."""
    part = Path(path).with_name(f".{Path(path).name}.part")
    with part.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(COLUMNS)
        for c in sorted(clips, key=lambda clip: clip.id):
            where = (c.id, c.speaker, c.split, c.source, f"{c.start:.2f}")
            table.writerow((*where, fps, c.n_frames, f"{c.n_frames / fps:.2f}", c.person))
    os.replace(part, path)


class Dataset:
    """A folder that `angie prepare` made.

    Attributes:
        path: the folder.
        manifest: content of `dataset.json`: format, fps, size, sample rate, sources.
    """

    def __init__(self, path: Path) -> None:
        """Read the table of clips.

        Raises:
            BadInput: no dataset, or of a newer format.
        """
        self.path = Path(path)
        for name in (MANIFEST, TABLE):
            if (self.path / name).exists():
                check_file(self.path / name)
        try:
            self.manifest: dict[str, Any] = json.loads((self.path / MANIFEST).read_bytes())
            (self.path / TABLE).open("rb").close()  # else it would be no dataset
            rows = read_table(self.path / TABLE, COLUMNS[:5] + COLUMNS[6:7])
            self._clips = [
                Clip(
                    id=row["clip_id"],
                    speaker=row["speaker"],
                    split=row["split"],
                    source=row["source"],
                    start=number(row["start"]),
                    n_frames=int(row["n_frames"]),
                    person=row.get("person", ""),
                )
                for row in rows
            ]
            version = int(self.manifest["format"])
        except OSError as error:
            raise BadInput(
                f"{path}: is not a dataset ({Path(str(error.filename)).name}: {error.strerror}); "
                "make one with angie prepare"
            ) from error
        except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
            what = "the dataset is damaged; prepare it again with --force"
            raise BadInput(f"{path}: {what}") from error
        if version > FORMAT:
            raise BadInput(f"{path}: made by a newer angie (format {version}); update angie")

    @property
    def digest(self) -> str:
        """Hash of what the dataset says of its sources, crops and clips."""
        text = b"".join((self.path / name).read_bytes() for name in (MANIFEST, TABLE))
        return hashlib.sha256(text).hexdigest()

    def clips(self, split: str | None = None, speaker: str | None = None) -> list[Clip]:
        """Clips in order of their ids, all or those of a split and of a speaker.

        The splits are "train", "val" (for choosing weights and settings; may be empty where a
        speaker has few clips) and "test".
        """
        return [
            clip
            for clip in self._clips
            if split in (None, clip.split) and speaker in (None, clip.speaker)
        ]

    def speakers(self) -> list[str]:
        """Names of the speakers in alphabetical order."""
        return sorted({clip.speaker for clip in self._clips})

    def frames(self, clip: Clip) -> FrameStore:
        """Frames of a clip, `(256, 256, 3)` uint8 RGB each, for reading in any order."""
        return FrameStore(self.path / "frames" / f"{clip.id}.safetensors", clip.n_frames)

    def sound(self, clip: Clip) -> np.ndarray:
        """Sound of a clip, `(N,)` float32 mono at 16 kHz, 640 samples for each frame."""
        samples = read_sound(self.path / "audio" / f"{clip.id}.wav")
        return samples[: clip.n_frames * SAMPLES_PER_FRAME]

    def speech(self, clip: Clip) -> Speech:
        """The recording of a clip with its words; features are read when they are asked for.

        A feature that is not stored is computed from the sound and stored beside the others.

        Raises:
            BadInput: from here or on reading a feature: missing or damaged.
        """
        path = self.path / "features" / f"{clip.id}.npz"
        if not path.is_file():
            raise BadInput(f"{path}: missing; prepare the dataset again")
        return Speech(
            functools.partial(self.sound, clip),
            self.words(clip),
            frames=clip.n_frames,
            store=FeatureFiles(path, clip.n_frames),
        )

    def words(self, clip: Clip) -> list[Word] | None:
        """Words of a clip with times from its start; None if the clip has no transcript."""
        path = self.path / "words" / f"{clip.id}.json"
        if not path.exists():
            return None
        return slice_words(read_words(path), 0.0, clip.n_frames / FPS)
