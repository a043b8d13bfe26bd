"""One phantom data set and one tiny bundle, made once and used by every end-to-end test.

With several test processes (`pytest -n 2`) one of them makes each and the others wait for it.
"""

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from filelock import FileLock
from safetensors.torch import save_file

from angie.bundle import Bundle
from angie.config import override, parse_overrides, preset
from angie.training import train
from data_prep.dataset import Dataset
from data_prep.phantom.make import make_phantom
from data_prep.prepare.prepare import prepare
from mraa.renderer import Renderer

FEW_STEPS = (
    "train_renderer.batch=2",
    "train_renderer.steps=60",
    "train_vq.schedule.most_steps=80",
    "train_vq.checks=4",
    "train_gpt.schedule.most_steps=30",
    "train_refiner.schedule.most_steps=20",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files that need the data set come first: while one process makes it, another does others."""
    needy = {item.path for item in items if "dataset" in getattr(item, "fixturenames", ())}
    items.sort(key=lambda item: item.path not in needy)


PROCESSES = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))


@pytest.fixture(scope="session", autouse=True)
def threads():
    torch.set_num_threads(max(1, min(2, torch.get_num_threads()) // PROCESSES))


@pytest.fixture(scope="session")
def made_once(tmp_path_factory) -> Callable[[str, Callable[[Path], object]], Path]:
    """Gives the folder of a name that all test processes share, after one of them has made it."""
    base = tmp_path_factory.getbasetemp()
    shared = (base.parent if PROCESSES > 1 else base) / "shared"
    shared.mkdir(exist_ok=True)

    def made(name: str, make: Callable[[Path], object]) -> Path:
        folder, done = shared / name, shared / f"{name}.done"
        with FileLock(shared / f"{name}.lock"):
            if not done.exists():
                shutil.rmtree(folder, ignore_errors=True)
                make(folder)
                done.touch()
        return folder

    return made


@pytest.fixture(scope="session")
def phantom_videos(made_once) -> Path:
    """Two presenters, about half a minute in all."""
    return made_once(
        "raw", lambda folder: make_phantom(folder, minutes=0.6, seed=0, presenters=2, jobs=2)
    )


@pytest.fixture(scope="session")
def dataset(phantom_videos, made_once) -> Dataset:
    """The phantom videos, prepared."""
    return Dataset(made_once("dataset", lambda folder: prepare([phantom_videos], folder, jobs=2)))


@pytest.fixture(scope="session")
def bundle(dataset, made_once) -> Bundle:
    """A tiny bundle trained through all stages, in few steps.

    So few are enough because the renderer begins with showing the source as it is.
    """

    def make(folder: Path) -> None:
        torch.manual_seed(0)
        weights = Renderer(preset("tiny").renderer).state_dict()
        weights["flow.occlusion.bias"] += 3
        initial = folder.parent / "initial.safetensors"
        save_file(weights, initial)
        changes = parse_overrides([*FEW_STEPS, f"train_renderer.initial={initial}"])
        train(dataset.path, folder, preset=override(preset("tiny"), changes))

    return Bundle.open(made_once("bundle", make))
