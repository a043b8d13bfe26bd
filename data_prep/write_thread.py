"""Encoding of a video beside the work that makes its frames."""

import queue
import threading
from types import TracebackType

import numpy as np

from data_prep.video_writer import VideoWriter


class WriteThread:
    """Hands frames to a `VideoWriter` in a thread of its own; a context manager.

    At most `held` batches wait, so that memory is bounded and a slow encoder slows the caller.
    FFmpeg lets Python go on while it converts and encodes. Leave this block before the writer's.

    Args:
        video: an open writer, used by nobody else meanwhile.
        held: most batches that wait.
    """

    def __init__(self, video: VideoWriter, held: int = 4) -> None:
        self._video = video
        self._waiting: queue.Queue[np.ndarray | None] = queue.Queue(held)
        self._error: BaseException | None = None
        self._stopped = False
        self._thread = threading.Thread(target=self._run, name="encoder", daemon=True)

    def write(self, frames: np.ndarray) -> None:
        """Append frames `(b, H, W, 3)` uint8 RGB, which must not be changed afterwards.

        Raises:
            BadInput: what the writer raised for earlier frames, such as damaged sound.
        """
        self._raise()
        self._waiting.put(frames)

    def _run(self) -> None:
        while (frames := self._waiting.get()) is not None:
            if self._error is not None or self._stopped:
                continue  # let a caller that waits for room go on to its own end
            try:
                for frame in frames:
                    self._video.write(frame)
            except BaseException as error:  # told to the caller, whose error it is
                self._error = error

    def _raise(self) -> None:
        if self._error is not None:
            raise self._error

    def __enter__(self) -> "WriteThread":
        """Start the thread."""
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Wait until all is written; after an error only for the frame under way."""
        self._stopped = kind is not None
        self._waiting.put(None)
        self._thread.join()
        if kind is None:
            self._raise()
