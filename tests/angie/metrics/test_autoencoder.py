"""The auto-encoder of FGD: sizes as published, the loss by hand, training, its file."""

import numpy as np
import pytest
import torch

from angie.metrics.autoencoder import (
    AutoencoderTraining,
    MotionAutoencoder,
    MotionScale,
    encode_windows,
    explained,
    load_autoencoder,
    reconstruction_loss,
    save_autoencoder,
    train_autoencoder,
    windows,
)
from data_prep.errors import BadInput
from mraa.training.run import Run, RunConfig

SHORT = AutoencoderTraining(batch=16, rate=5e-3)


def trained(motion, folder, seed, steps=60):
    run = Run(folder, "fgd", steps=steps, seed=seed, config=RunConfig("cpu"))
    return train_autoencoder(motion, run, SHORT)


@pytest.mark.parametrize(("frames", "flat"), [(34, 384), (64, 864), (96, 1376)])
def test_flattened_sizes_are_the_published_ones(frames, flat):
    model = MotionAutoencoder(6, frames)
    linear = next(layer for layer in model.encoder if isinstance(layer, torch.nn.Linear))
    assert linear.in_features == flat
    motion = torch.randn(2, frames, 6)
    assert model.encode(motion).shape == (2, 32) and model(motion).shape == motion.shape


def test_windows_end_inside_their_clips():
    clips = [np.arange(20.0)[:, None], np.arange(9.0)[:, None], np.arange(10.0)[:, None]]
    cut = windows(clips, frames=10, hop=5)
    assert cut[:, 0, 0].tolist() == [0, 5, 10, 0] and cut.shape == (4, 10, 1)
    assert windows(clips[1:2], frames=10).shape == (0, 10, 1)
    assert windows([]).shape[0] == 0


def test_the_loss_is_summed_over_the_batch():
    motion = torch.zeros(2, 3, 1)
    made = torch.tensor([[[1.0], [1.0], [4.0]], [[0.0], [0.0], [0.0]]])
    # mean |1 1 4| = 2, mean |0 3| = 1.5
    assert reconstruction_loss(made, motion).item() == pytest.approx(3.5)


@pytest.fixture(scope="module")
def motion() -> np.ndarray:
    rng = np.random.default_rng(0)
    phase = rng.uniform(0, 6, (64, 1, 1))
    at = np.arange(34)[None, :, None]
    return np.sin(phase + at / 6 + np.arange(4)).astype(np.float32)


@pytest.fixture(scope="module")
def model(motion, tmp_path_factory) -> MotionAutoencoder:
    return trained(motion, tmp_path_factory.mktemp("fgd"), 1)


def test_training_learns_and_follows_from_the_seed(motion, model, tmp_path):
    assert explained(model, motion) > 0.5
    assert explained(trained(motion, tmp_path, 1, steps=1), motion) < 0.1
    torch.manual_seed(5)
    again = trained(motion, tmp_path, 1)
    assert np.array_equal(encode_windows(model, motion), encode_windows(again, motion))
    other = trained(motion, tmp_path, 2)
    assert not np.allclose(encode_windows(model, motion), encode_windows(other, motion))
    assert encode_windows(model, motion[:0]).shape == (0, 32)
    with pytest.raises(ValueError, match="two windows"):
        train_autoencoder(motion[:1], None)


def test_steps_are_those_of_the_epochs_up_to_a_bound():
    training = AutoencoderTraining(batch=16, epochs=3, most_steps=10)
    assert [training.steps(windows) for windows in (2, 33, 64)] == [3, 6, 10]
    assert AutoencoderTraining(batch=16, epochs=3, most_steps=None).steps(640) == 120


def test_a_file_holds_all_that_the_features_depend_on(motion, model, tmp_path):
    scale = MotionScale(("ada", "bob"), np.ones((2, 4), np.float32), np.full(4, 2, np.float32))
    path = tmp_path / "fgd.safetensors"
    save_autoencoder(path, model, scale, "abc", 25, SHORT, seed=1)
    read = load_autoencoder(path)
    assert np.array_equal(encode_windows(read.model, motion), encode_windows(model, motion))
    assert read.estimator == "abc" and read.fps == 25 and read.training["seed"] == 1
    np.testing.assert_array_equal(read.scale.standard(np.full((3, 4), 5.0), "bob"), 2)
    with pytest.raises(BadInput, match="ada, bob"):
        read.scale.standard(np.zeros((3, 4)), "carl")
    save_autoencoder(tmp_path / "again.safetensors", model, scale, "abc", 25, SHORT, seed=1)
    assert (tmp_path / "again.safetensors").read_bytes() == path.read_bytes()


def test_other_files_are_refused(tmp_path):
    (tmp_path / "text").write_text("not tensors")
    for name in ("text", "missing"):
        with pytest.raises(BadInput, match="not an autoencoder of FGD"):
            load_autoencoder(tmp_path / name)
