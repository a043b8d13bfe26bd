"""Frames encoded beside the caller arrive whole, in order, and errors come back."""

import threading
import time

import numpy as np
import pytest

from data_prep.errors import BadInput
from data_prep.media.video import VideoWriter, read_frames
from data_prep.media.writer import WriteThread


def test_frames_arrive_in_order(tmp_path):
    path = tmp_path / "out.mp4"
    grey = np.arange(20, 220, 20)
    with VideoWriter(path, (32, 32)) as video, WriteThread(video, held=2) as thread:
        for first in range(0, 10, 3):
            part = grey[first : first + 3, None, None, None]
            thread.write(np.broadcast_to(part, (len(part), 32, 32, 3)).astype(np.uint8))
    found = np.stack(list(read_frames(path))).mean(axis=(1, 2, 3))
    np.testing.assert_allclose(found, grey, atol=3)


class Broken:
    """A writer that fails at the third frame."""

    def __init__(self):
        self.count = 0

    def write(self, frame):
        self.count += 1
        if self.count == 3:
            raise BadInput("the sound is damaged")


def test_an_error_reaches_the_caller():
    frames = np.zeros((1, 2, 2, 3), np.uint8)
    with pytest.raises(BadInput, match="damaged"), WriteThread(Broken()) as thread:
        for _ in range(100):
            thread.write(frames)


def test_an_error_of_the_last_frame_reaches_the_caller():
    with pytest.raises(BadInput, match="damaged"), WriteThread(Broken()) as thread:
        thread.write(np.zeros((3, 2, 2, 3), np.uint8))


class Slow:
    """A writer that takes its time."""

    def __init__(self):
        self.count = 0

    def write(self, frame):
        time.sleep(0.01)
        self.count += 1


def test_a_caller_that_fails_does_not_wait_for_all_frames():
    slow = Slow()
    with pytest.raises(KeyError), WriteThread(slow, held=8) as thread:
        for _ in range(8):
            thread.write(np.zeros((10, 2, 2, 3), np.uint8))
        raise KeyError
    assert slow.count < 80
    assert not any(t.name == "encoder" for t in threading.enumerate())
