"""One phantom data set and one tiny bundle, made once and used by every end-to-end test."""

from pathlib import Path

import pytest
import torch

from angie.bundle import Bundle
from angie.config import override, parse_overrides, preset
from angie.training import train
from data_prep.dataset import Dataset
from data_prep.phantom.make import make_phantom
from data_prep.prepare.prepare import prepare

FEW_STEPS = (
    "train_renderer.batch=2",
    "train_renderer.steps=200",
    "train_vq.schedule.most_steps=80",
    "train_vq.checks=4",
    "train_gpt.schedule.most_steps=30",
    "train_refiner.schedule.most_steps=20",
)


@pytest.fixture(scope="session", autouse=True)
def two_threads():
    torch.set_num_threads(min(2, torch.get_num_threads()))


@pytest.fixture(scope="session")
def phantom_videos(tmp_path_factory) -> Path:
    """Two presenters, about half a minute in all."""
    folder = tmp_path_factory.mktemp("phantom") / "raw"
    make_phantom(folder, minutes=0.6, seed=0, presenters=2, jobs=2)
    return folder


@pytest.fixture(scope="session")
def dataset(phantom_videos) -> Dataset:
    """The phantom videos, prepared."""
    folder = phantom_videos.parent / "dataset"
    prepare([phantom_videos], folder, jobs=2)
    return Dataset(folder)


@pytest.fixture(scope="session")
def bundle(dataset) -> Bundle:
    """A tiny bundle trained through all stages: few steps, most for the renderer."""
    changes = parse_overrides(list(FEW_STEPS))
    return train(
        dataset.path, dataset.path.parent / "bundle", preset=override(preset("tiny"), changes)
    )
