"""A folder of joints and a model trained on it."""

import sys

import numpy as np
import pytest

from angie.cli import main
from data_prep.media.audio import write_wav

FPS = 15
TINY = (
    "vq.width=8 vq.codes=16 vq.code_width=8 gpt.codes=16 gpt.width=16 gpt.heads=2 gpt.layers=1 "
    "refiner.sound=8 refiner.motion=8 refiner.hidden=8 "
    "train_vq.schedule.most_steps=4 train_gpt.schedule.most_steps=4 "
    "train_refiner.schedule.most_steps=4"
).split()


@pytest.fixture
def tiny() -> list[str]:
    """Settings of a model that trains in a moment."""
    return TINY


@pytest.fixture(scope="session")
def data(tmp_path_factory):
    """Twelve clips of six seconds at 15 frames a second, in pixels."""
    folder = tmp_path_factory.mktemp("joints") / "data"
    (folder / "motion").mkdir(parents=True)
    (folder / "audio").mkdir()
    rows = ["clip,speaker,split,fps"]
    rng = np.random.default_rng(0)
    for number in range(12):
        name, frames = f"c{number}", 6 * FPS
        points = np.array([[100.0, 50], [60, 120], [140, 120]]) + rng.normal(size=(frames, 3, 2))
        points[:, 1:, 1] += 20 * np.sin(np.arange(frames) / 4 + number)[:, None]
        if number % 2:
            np.save(folder / "motion" / f"{name}.npy", points.astype(np.float32))
        else:
            np.savez(folder / "motion" / f"{name}.npz", points=points)
        sound = 0.1 * rng.normal(size=6 * 16_000) * (np.arange(6 * 16_000) // 8000 % 2)
        write_wav(folder / "audio" / f"{name}.wav", sound, 16_000)
        rows.append(
            f"{name},{'ada' if number % 2 else 'bob'},{'test' if number > 9 else 'train'},{FPS}"
        )
    (folder / "clips.csv").write_text("\n".join(rows) + "\n")
    return folder


@pytest.fixture(scope="session")
def model(data):
    """A model of joints, hardly trained."""
    folder = data.parent / "model"
    options = ["--preset", "tiny", "--device", "cpu", *TINY]
    old, sys.argv = sys.argv, ["angie", "train", str(data), "-o", str(folder), *options]
    try:
        main()
    except SystemExit as leave:
        assert not leave.code
    finally:
        sys.argv = old
    return folder
