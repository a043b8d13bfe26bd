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

SHORT = AutoencoderTraining(batch=16, most_steps=60, rate=5e-3)


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
def model(motion) -> MotionAutoencoder:
    return train_autoencoder(motion, SHORT, seed=1)


def test_training_learns_and_follows_from_the_seed(motion, model):
    assert explained(model, motion) > 0.5
    untrained = train_autoencoder(motion, AutoencoderTraining(most_steps=1), seed=1)
    assert explained(untrained, motion) < 0.1
    torch.manual_seed(5)
    before = torch.random.get_rng_state()
    again = train_autoencoder(motion, SHORT, seed=1)
    assert torch.equal(torch.random.get_rng_state(), before)
    assert np.array_equal(encode_windows(model, motion), encode_windows(again, motion))
    other = train_autoencoder(motion, SHORT, seed=2)
    assert not np.allclose(encode_windows(model, motion), encode_windows(other, motion))
    assert encode_windows(model, motion[:0]).shape == (0, 32)
    with pytest.raises(ValueError, match="two windows"):
        train_autoencoder(motion[:1])


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
        with pytest.raises(BadInput, match="no auto-encoder of FGD"):
            load_autoencoder(tmp_path / name)
