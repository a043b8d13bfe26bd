"""Shots: cuts, jumps, fades and flashes end them; gestures do not."""

import cv2
import numpy as np
import pytest

from data_prep.prepare.shots import Shot, ShotDetector


def scene(seed: int, frames: int) -> np.ndarray:
    """A still textured room in which a bright hand of 50x50 pixels swings, 25 frames a swing."""
    rng = np.random.default_rng(seed)
    room = cv2.resize(rng.integers(20, 235, (6, 10)).astype(np.uint8), (320, 180))
    pictures = np.repeat(room[None], frames, axis=0)
    for k, picture in enumerate(pictures):
        x = round(110 + 50 * np.sin(2 * np.pi * k / 25))
        picture[90:140, x : x + 50] = 230
    return pictures


def shots(pictures: np.ndarray) -> list[Shot]:
    detector = ShotDetector()
    for picture in pictures:
        detector.add(picture)
    return detector.shots()


def test_gestures_break_nothing() -> None:
    assert shots(scene(0, 200)) == [Shot(0, 200)]


def test_a_cut_is_found_in_its_frame() -> None:
    joined = np.concatenate([scene(0, 70), scene(1, 60), scene(2, 50)])
    assert shots(joined) == [Shot(0, 70), Shot(70, 130), Shot(130, 180)]


def test_a_jump_within_a_scene_is_found() -> None:
    still = np.repeat(scene(0, 1), 120, axis=0)
    still[60:, 60:120, 200:260] = 240
    assert shots(still) == [Shot(0, 60), Shot(60, 120)]


@pytest.mark.parametrize("frames", [1, 3])
def test_a_flash_is_no_part_of_a_shot(frames: int) -> None:
    lit = scene(0, 120)
    lit[60 : 60 + frames] = 255 - (255 - lit[60 : 60 + frames]) // 4
    found = shots(lit)
    assert found[0] == Shot(0, 60) and found[-1] == Shot(60 + frames, 120)


@pytest.mark.parametrize("frames", [12, 25, 50])
def test_a_cross_fade_is_left_out(frames: int) -> None:
    first, second = scene(0, 80 + frames), scene(1, 80 + frames)
    t = ((np.arange(frames) + 1) / (frames + 1))[:, None, None]
    mixed = ((1 - t) * first[80:] + t * second[:frames]).astype(np.uint8)
    before, fade, after = shots(np.concatenate([first[:80], mixed, second[frames:]]))
    assert fade.faded and not before.faded and not after.faded
    # What is mixed by more than a tenth is in no shot.
    assert before.stop <= 80 + 0.1 * frames + 1 and after.first >= 80 + 0.9 * frames - 1
    assert before.stop > 50 and after.first < 110 + frames


def test_a_fade_through_black_is_left_out() -> None:
    pictures = scene(0, 200).astype(np.float32)
    pictures *= np.clip(np.abs(np.arange(200) - 100) / 15, 0, 1)[:, None, None]
    found = shots(pictures.astype(np.uint8))
    assert all(shot.faded for shot in found if shot.first < 112 and shot.stop > 88)
    assert not found[0].faded and not found[-1].faded


def test_repeated_pictures_count_as_shown() -> None:
    detector = ShotDetector()
    for picture in np.concatenate([scene(0, 30), scene(1, 30)]):
        detector.add(picture, frames=3)
    assert detector.shots() == [Shot(0, 90), Shot(90, 180)]
