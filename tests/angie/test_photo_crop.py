"""Whom `animate` takes in a photo, and what it says when it cannot tell."""

import cv2
import numpy as np
import pytest

from angie.bundle import PHOTO
from angie.source import photo_crop
from data_prep.errors import BadInput
from data_prep.media.photo import read_photo


@pytest.fixture(scope="module")
def portrait():
    photo = read_photo(PHOTO)
    return cv2.resize(photo, None, fx=0.6, fy=0.6, interpolation=cv2.INTER_AREA)


def test_one_person_is_taken_whatever_is_asked(portrait):
    crops = {photo_crop(PHOTO, portrait, who) for who in (None, "left")}
    assert len(crops) == 1


def test_several_people_are_refused_or_one_is_chosen(portrait):
    small = cv2.resize(portrait, None, fx=0.8, fy=0.8, interpolation=cv2.INTER_AREA)
    small = np.pad(small, ((0, portrait.shape[0] - small.shape[0]), (0, 0), (0, 0)), "edge")
    both = np.hstack([small, portrait])
    with pytest.raises(BadInput, match="both.png: shows 2 people; choose .*--person.*--crop"):
        photo_crop("both.png", both)
    with pytest.raises(BadInput, match="right or largest$"):
        photo_crop("both.png", both, with_crop=False)
    left, largest = (photo_crop("", both, who) for who in ("left", "largest"))
    assert left.x < small.shape[1] / 2 < largest.x and left.size < largest.size
    with pytest.raises(BadInput, match="--person middle"):
        photo_crop("", both, "middle")


def test_nobody_is_refused():
    with pytest.raises(BadInput, match="wall.png: no face found; .*--crop"):
        photo_crop("wall.png", np.full((240, 320, 3), 120, np.uint8))
