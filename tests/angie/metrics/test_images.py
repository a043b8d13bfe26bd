"""AED, AKD, MKR and flicker by hand; the identity network tells people apart."""

import numpy as np
import pytest
import torch

from angie.metrics import images
from angie.metrics.images import IdentityTraining, embed, train_identity, triplet_loss
from data_prep.errors import BadInput


def test_aed_is_the_mean_absolute_difference():
    real, made = np.zeros((2, 2)), np.array([[1.0, 3.0], [0.0, 0.0]])
    assert images.aed([real], [made]).value == 1
    assert images.aed([made], [made]).value == 0
    assert images.aed([], []).value is None
    with pytest.raises(ValueError, match="same shapes"):
        images.aed([real], [made[:1]])


def test_akd_takes_points_seen_in_both_and_mkr_counts_the_others():
    real = np.array([[[0.0, 0.0], [1.0, 1.0], [np.nan, np.nan]]])
    made = np.array([[[3.0, 1.0], [np.nan, np.nan], [5.0, 5.0]]])
    assert images.akd([real], [made]).value == 2
    assert images.mkr([real], [made]).value == 0.5
    assert images.mkr([real], [real]).value == 0 and images.akd([real], [real]).value == 0
    nothing = np.full((1, 3, 2), np.nan)
    assert images.akd([nothing], [made]).value is None
    assert images.mkr([nothing], [made]).value is None and images.mkr([made], [nothing]).value == 1


def test_flicker_is_blind_to_what_stays():
    real = np.zeros((4, 2, 2, 3))
    assert images.flicker(real, real + 0.5) == 0
    blinking = real.copy()
    blinking[1::2] = 0.2
    assert images.flicker(real, blinking) == pytest.approx(0.2)


def test_arrays_of_another_network(tmp_path):
    path = tmp_path / "clip.npz"
    np.savez(path, real_embeddings=np.ones((3, 4)), made_embeddings=np.zeros((2, 4)))
    real, made = images.read_pair(path, "embeddings")
    assert real.shape == made.shape == (2, 4) and images.aed([real], [made]).value == 1
    assert images.read_pair(path, "points") is None


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"real_points": np.ones((3, 4, 2))}, "only one of"),
        ({"real_points": np.ones((3, 4, 2)), "made_points": np.ones((3, 5, 2))}, "shapes"),
        ({"real_points": np.ones((3, 4)), "made_points": np.ones((3, 4))}, "shapes"),
        ({"real_points": np.ones((3, 4, 2), int), "made_points": np.ones((3, 4, 2))}, "floating"),
        (None, "not a readable .npz file"),
    ],
)
def test_arrays_that_cannot_be_used_are_refused(tmp_path, arrays, words):
    path = tmp_path / "clip.npz"
    if arrays is None:
        path.write_text("nothing")
    else:
        np.savez(path, **arrays)
    with pytest.raises(BadInput, match=words):
        images.read_pair(path, "points")


def test_embeddings_that_are_not_finite_are_refused(tmp_path):
    path = tmp_path / "clip.npz"
    np.savez(path, real_embeddings=np.full((3, 4), np.nan), made_embeddings=np.zeros((3, 4)))
    with pytest.raises(BadInput, match="embeddings must be finite"):
        images.read_pair(path, "embeddings")


def test_triplet_loss_by_hand():
    one = torch.tensor([[1.0, 0.0], [0.0, 1.0]])
    assert triplet_loss(torch.stack([one, one]), 0.2) == 0  # others at squared distance 2
    assert triplet_loss(torch.stack([one, one]), 2.5) == pytest.approx(0.5)
    assert triplet_loss(torch.stack([one, one.flip(0)]), 0.2) == pytest.approx(2.2)


def test_the_identity_network_tells_people_apart():
    rng = np.random.default_rng(0)
    colours = rng.integers(40, 216, (4, 1, 1, 1, 3))
    people = (colours + rng.integers(-40, 40, (4, 8, 64, 64, 3))).clip(0, 255).astype(np.uint8)
    short = IdentityTraining(steps=25, clips=4)
    model = train_identity([person[:6] for person in people], short, seed=1)
    first, second = embed(model, people[:, 6]), embed(model, people[:, 7])
    same = images.aed([first], [second]).value
    other = images.aed([first], [np.roll(second, 1, axis=0)]).value
    assert same * 2 < other
    again = train_identity([person[:6] for person in people], short, seed=1)
    assert np.array_equal(embed(again, people[:, 6]), first)
    assert embed(model, people[0, :0]).shape == (0, 64)
    with pytest.raises(ValueError, match="two clips"):
        train_identity([people[0]])
