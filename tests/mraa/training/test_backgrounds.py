"""A person before a blue screen is keyed, and put before another background, both frames alike."""

import numpy as np
import pytest

from mraa.training.backgrounds import GREY, Screen, background, bank, exchanged
from mraa.training.pairs import Augmentation, FramePairs

BLUE, SKIN = (25, 160, 205), (205, 150, 120)


def before_a_screen(left=96):
    """A block of skin before a screen that is brighter on one side, (128, 128, 3) uint8."""
    light = np.linspace(0.8, 1.2, 128)[None, :, None]
    frame = np.clip(np.array(BLUE) * light * np.ones((128, 1, 1)), 0, 255).astype(np.uint8)
    frame[40:, left - 64 : left] = SKIN
    return frame


def test_the_screen_is_found_and_the_person_is_kept():
    screen = Screen(before_a_screen())
    assert screen.there
    over, matte = screen.key(before_a_screen())
    assert (matte[44:, 36:92] == 255).all() and (matte[:36] == 0).all()
    assert np.abs(over[44:, 36:92].astype(int) - SKIN).max() <= 1
    assert np.abs(over[:36].astype(int) - GREY).max() <= 1  # without what was blue


@pytest.mark.parametrize("colour", [(90, 100, 110), (200, 60, 40), (10, 12, 30)])
def test_other_walls_are_no_screen(colour):
    random = np.random.default_rng(0)
    wall = np.array(colour) + random.integers(-8, 9, (128, 128, 3))
    assert not Screen(np.clip(wall, 0, 255).astype(np.uint8)).there


def test_a_picture_with_some_blue_things_is_no_screen():
    frame = np.random.default_rng(0).integers(0, 255, (128, 128, 3)).astype(np.uint8)
    assert not Screen(frame).there


@pytest.mark.parametrize("seed", range(6))
def test_both_frames_get_one_background_and_one_light(seed):
    pair = np.stack([before_a_screen(96), before_a_screen(100)])
    screen = Screen(pair[0])
    made = exchanged(pair, screen, np.random.default_rng(seed))
    assert np.abs(made[0][:, 104:].astype(int) - made[1][:, 104:]).max() <= 1  # ground in both
    person = made[0][60:, 44:90].astype(int)
    assert np.abs(person - made[1][60:, 44:90]).max() <= 1 and person.std((0, 1)).max() < 2
    assert np.array_equal(made, exchanged(pair, screen, np.random.default_rng(seed)))
    ground = background(128, screen, np.random.default_rng(seed))
    assert ground.shape == (128, 128, 3) and 0 <= ground.min() and ground.max() <= 255


def test_the_bank_is_the_same_every_time_and_holds_photos_and_rooms():
    bank.cache_clear()
    first = bank()
    bank.cache_clear()
    assert len(first) >= 56 + 15
    assert all(np.array_equal(a, b) for a, b in zip(first, bank(), strict=True))
    assert {image.shape for image in first} == {(320, 320, 3)}


def test_pairs_without_a_screen_are_what_they_were(dataset):
    clips = dataset.clips("train")
    plain = FramePairs(dataset, clips, Augmentation()).draw(0, np.random.default_rng(5))
    how = Augmentation(background=1.0)
    assert (
        plain.frames == FramePairs(dataset, clips, how).draw(0, np.random.default_rng(5))[0]
    ).all()
