"""Frames of a clip as JPEG in one memory-mapped file, read in any order."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from data_prep.errors import BadInput

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
    save_file({"jpeg": np.concatenate(parts), "offset": offset}, str(path))


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
            self._file = safe_open(str(self.path), framework="numpy")
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
        frame = cv2.imdecode(np.asarray(data), cv2.IMREAD_COLOR)
        if frame is None:
            raise BadInput(f"{self.path}: frame {index} is damaged; prepare the dataset again")
        return cv2.cvtColor(frame, cv2.COLOR_BGR2RGB)

    def __getstate__(self) -> dict[str, Path | int | None]:
        return {"path": self.path, "count": self.count}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.path, self.count = state["path"], state["count"]
        self._open()
