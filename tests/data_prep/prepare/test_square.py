"""The one square of a video, whoever stands wherever in it."""

from pathlib import Path

import numpy as np
import pytest

from data_prep.errors import BadInput
from data_prep.media.video import VideoWriter, probe
from data_prep.phantom.make import still
from data_prep.prepare.square import find_square, given_square
from data_prep.speaker.crop import Crop, find_people, speaker_crop

PICTURE = still(0, seed=5)


def write(path: Path, pictures: list[np.ndarray]) -> Path:
    height, width = pictures[0].shape[:2]
    with VideoWriter(path, (width, height)) as video:
        for picture in pictures:
            video.write(picture)
    return path


def found(path: Path, person: str | None = None):
    return find_square(path, probe(path), person, "--drive-crop")


def near(crop: Crop, wanted: Crop) -> bool:
    pairs = ((crop.x, wanted.x), (crop.y, wanted.y), (crop.size, wanted.size))
    return all(abs(a - b) < 0.06 * wanted.size for a, b in pairs)


@pytest.mark.parametrize("length", [1, 40])
def test_the_square_is_that_of_a_photo(tmp_path: Path, length: int) -> None:
    square = found(write(tmp_path / "a.mp4", [PICTURE] * length))
    wanted = speaker_crop(find_people(PICTURE)[0], *PICTURE.shape[:2])
    assert near(square.crop, wanted)
    assert square.frames == length and square.cuts == 0
    pictures = list(square.pictures())
    assert len(pictures) == length and pictures[0].shape == (256, 256, 3)


def test_bars_stay_outside(tmp_path: Path) -> None:
    height, width = PICTURE.shape[:2]
    framed = np.zeros((height + 120, width, 3), np.uint8)
    framed[60:-60] = PICTURE
    square = found(write(tmp_path / "a.mp4", [framed] * 30))
    wanted = speaker_crop(find_people(PICTURE)[0], height, width)
    assert near(square.crop, Crop(wanted.x, wanted.y + 60, wanted.size))
    assert next(square.pictures())[0].mean() > 20


def test_several_people_are_refused_or_one_is_chosen(tmp_path: Path) -> None:
    both = np.concatenate([PICTURE, still(1, seed=5)], axis=1)
    path = write(tmp_path / "a.mp4", [both] * 30)
    with pytest.raises(BadInput, match="shows 2 people; choose with --drive-person .*--drive-crop"):
        found(path)
    left, right = found(path, "left"), found(path, "right")
    middle = PICTURE.shape[1]
    assert left.crop.x + left.crop.size / 2 < middle < right.crop.x + right.crop.size / 2


def test_nobody_and_nowhere_are_told(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mp4", [np.full((120, 160, 3), 90, np.uint8)] * 3)
    with pytest.raises(BadInput, match="no face found; .* --drive-crop"):
        found(path)
    with pytest.raises(BadInput, match="--drive-crop: the square lies outside"):
        given_square(path, probe(path), Crop(500, 0, 50), "--drive-crop")
    square = given_square(path, probe(path), Crop(0, 0, 100), "--drive-crop")
    assert len(list(square.pictures())) == square.frames == 3


def test_cuts_are_counted(tmp_path: Path) -> None:
    other = np.random.default_rng(0).integers(0, 255, PICTURE.shape, np.uint8)
    square = found(write(tmp_path / "a.mp4", [PICTURE] * 30 + [other] * 20))
    assert square.cuts == 1 and square.frames == 50
