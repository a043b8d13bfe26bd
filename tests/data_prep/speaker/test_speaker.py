"""The speaker: faces found, and one crop rule for photos and videos."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from data_prep.media.photo import read_photo
from data_prep.speaker.crop import (
    Crop,
    Face,
    cut_out,
    find_faces,
    find_people,
    median_face,
    speaker_crop,
)

SHARED = Path(__file__).resolve().parents[3].parent / "shared" / "data" / "photo"
Draw = Callable[..., np.ndarray]


@pytest.mark.parametrize(("x", "y", "scale"), [(240, 110, 0.75), (150, 90, 0.6), (300, 150, 1.2)])
def test_face_is_found_where_it_is(person: Draw, x: float, y: float, scale: float) -> None:
    faces = find_faces(person(x=x, y=y, scale=scale))
    assert len(faces) == 1
    assert abs(faces[0].centre_x - x) < 8 * scale
    assert abs(faces[0].centre_y - y) < 15 * scale
    assert 70 * scale < faces[0].h < 130 * scale


def test_neighbourhood_search_agrees_with_the_whole(person: Draw) -> None:
    image = person()
    whole = find_faces(image)[0]
    near = find_faces(image, Face(whole.x + 15, whole.y - 10, whole.w, whole.h))[0]
    assert abs(near.centre_x - whole.centre_x) < 5 and abs(near.centre_y - whole.centre_y) < 5
    assert find_faces(image, Face(-500, 10, 60, 60)) == []


def test_largest_face_comes_first(person: Draw) -> None:
    both = np.hstack([person(width=240, x=120, scale=0.6), person(width=240, x=120, scale=0.9)])
    faces = find_faces(both)
    assert len(faces) == 2
    assert faces[0].h > faces[1].h and faces[0].centre_x > 240


def test_everybody_who_counts_is_found(person: Draw) -> None:
    both = np.hstack([person(width=240, x=120, scale=0.6), person(width=240, x=120, scale=0.9)])
    small = np.hstack([person(width=240, x=120, scale=1.0), person(width=240, x=120, scale=0.35)])
    assert [len(find_people(image)) for image in (person(), both, small)] == [1, 2, 1]
    grey = cv2.cvtColor(both, cv2.COLOR_RGB2GRAY)
    assert find_people(grey) == find_people(both)


def test_no_face_is_found_in_noise_or_flat_colour() -> None:
    noise = np.random.default_rng(0).integers(0, 255, (200, 300, 3), dtype=np.uint8)
    assert find_faces(noise) == []
    assert find_faces(np.full((200, 300, 3), 90, np.uint8)) == []


def test_median_face_ignores_a_stray() -> None:
    faces = [Face(10, 20, 40, 40), Face(12, 20, 40, 40), Face(300, 5, 90, 90)]
    assert median_face(faces) == Face(12, 20, 40, 40)


def test_crop_rule_by_hand() -> None:
    # Side 4.2 x 100; the face's centre (500, 350) is at half the side and 0.27 of it.
    crop = speaker_crop(Face(450, 300, 100, 100), 1000, 1000)
    assert crop == Crop(500 - 210, round(350 - 0.27 * 420), 420)
    # Too close to the left and the top: moved inside.
    assert speaker_crop(Face(0, 0, 100, 100), 1000, 1000) == Crop(0, 0, 420)
    assert speaker_crop(Face(900, 900, 100, 100), 1000, 1000) == Crop(580, 580, 420)
    # Larger than the picture: its shorter side.
    assert speaker_crop(Face(300, 50, 200, 200), 600, 800) == Crop(100, 0, 600)
    # A face wider than that: the edges continue the picture on both sides.
    assert speaker_crop(Face(5, 100, 90, 90), 400, 100) == Crop(-13, 111, 126)


def test_cut_out_scales_without_aliasing_or_shift() -> None:
    ramp = np.repeat(np.arange(200, dtype=np.uint8)[None], 200, axis=0)
    image = np.stack([ramp, ramp.T, ramp], axis=2)
    half = cut_out(image, Crop(20, 40, 128), 64)
    np.testing.assert_allclose(half[10, :, 0], 20.5 + 2 * np.arange(64), atol=1)
    np.testing.assert_allclose(half[:, 10, 1], 40.5 + 2 * np.arange(64), atol=1)
    board = (np.indices((256, 256)).sum(axis=0) % 2 * 255).astype(np.uint8)
    flat = cut_out(np.repeat(board[..., None], 3, axis=2), Crop(0, 0, 256), 64)
    np.testing.assert_allclose(flat, 127.5, atol=1)


def test_cut_out_repeats_the_edge_outside() -> None:
    image = np.full((40, 40, 3), 10, np.uint8)
    image[:, -1] = 200
    outside = cut_out(image, Crop(30, -10, 30), 30)
    assert (outside[:, :9] == 10).all() and (outside[:, 10:] == 200).all()
    assert (cut_out(image, Crop(100, 100, 16), 16) == 200).all()


@pytest.mark.slow
@pytest.mark.skipif(not SHARED.is_dir(), reason="the real photos are not here")
@pytest.mark.parametrize(
    ("name", "centre", "height"),
    [
        ("flux_man_0001.png", (507, 200), 203),
        ("flux_man_0055.png", (509, 196), 222),
        ("flux_woman_0201.png", (505, 215), 243),
        ("pats_001.png", (103, 63), 59),
        ("pats_003.png", (117, 87), 71),
        ("frame_latentsync_man_sofa_20s.png", (544, 632), 248),
        ("official_obama.jpg", (495, 242), 282),
        ("official_biden.jpg", (592, 367), 321),
        ("derived_obama_exif6.jpg", (495, 242), 282),
        ("derived_astronaut_gray.png", (224, 114), 96),
        ("derived_astronaut_tiny64.png", (28, 14), 12),
        ("obama_podium_rgba.png", (306, 406), 328),
        ("woman_curly_1404.jpg", (718, 851), 779),
        ("skimage_astronaut.png", (224, 114), 96),
    ],
)
def test_real_faces(name: str, centre: tuple[float, float], height: float) -> None:
    face = find_faces(read_photo(SHARED / name))[0]
    assert abs(face.centre_x - centre[0]) < 0.1 * height
    assert abs(face.centre_y - centre[1]) < 0.1 * height
    assert abs(face.h - height) < 0.15 * height


@pytest.mark.slow
@pytest.mark.skipif(not SHARED.is_dir(), reason="the real photos are not here")
@pytest.mark.parametrize("name", ["landscape_no_person.jpg", "skimage_coffee.png"])
def test_no_face_in_pictures_without_people(name: str) -> None:
    assert find_faces(read_photo(SHARED / name)) == []


@pytest.mark.slow
@pytest.mark.skipif(not SHARED.is_dir(), reason="the real photos are not here")
@pytest.mark.parametrize(
    ("name", "least"), [("group_solvay1927.jpg", 20), ("two_people.jpg", 2), ("pats_003.png", 1)]
)
def test_people_in_real_photos(name: str, least: int) -> None:
    found = find_people(read_photo(SHARED / name))
    assert len(found) >= least and (least > 2 or len(found) == least)
