"""Frames of a real talking video are read fast and stay small."""

import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from data_prep.dataset import MAX_BYTES, Dataset, FrameStore, encode_frame, write_frames
from data_prep.prepare.prepare import prepare

VIDEO = (
    Path(__file__).resolve().parents[2].parent
    / "shared"
    / "data"
    / "video"
    / "latentsync_man_sofa_20s.mp4"
)


def test_frames_left_unused_are_not_given(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    frames = [np.full((256, 256, 3), 20 * k, np.uint8) for k in range(5)]
    write_frames(path, map(encode_frame, frames))
    store = FrameStore(path, 3)
    assert len(store) == 3 and abs(int(store[-1][0, 0, 0]) - 40) <= 1
    with pytest.raises(IndexError):
        store[3]


@pytest.mark.slow
@pytest.mark.skipif(not VIDEO.exists(), reason="needs the shared data")
def test_a_random_pair_takes_under_5_ms_of_one_core(tmp_path: Path) -> None:
    prepare([VIDEO], tmp_path / "data")
    data = Dataset(tmp_path / "data")
    clips = data.clips()
    random = np.random.default_rng(0)
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        begun = time.process_time()
        for _ in range(500):
            store = data.frames(clips[int(random.integers(len(clips)))])
            first, second = random.integers(len(store), size=2)
            np.stack([store[int(first)], store[int(second)]])
        each = (time.process_time() - begun) / 500
    finally:
        cv2.setNumThreads(threads)
    assert each < 5e-3
    files = list((data.path / "frames").iterdir())
    stored = sum(len(FrameStore(file)) for file in files)
    assert sum(file.stat().st_size for file in files) / stored < MAX_BYTES
