import numpy as np
import pytest

from angie.source import MAX_LENGTH, MAX_SIDE, framing
from data_prep.errors import BadInput
from data_prep.speaker.crop import Crop, cut_out


def photo(height, width):
    return np.random.default_rng(0).integers(0, 256, (height, width, 3), dtype=np.uint8)


def test_the_usual_size_is_the_renderers_own():
    shown = framing(photo(300, 400), Crop(0, 0, 300))
    assert shown.width_height == (256, 256) and shown.canvas(align_corners=True) is None
    assert shown.note == ""


@pytest.mark.parametrize(("side", "wanted"), [(301, 300), (300, 300), (256, 256)])
def test_the_photos_own_size_is_even_and_its_pixels_are_kept(side, wanted):
    image = photo(400, 500)
    shown = framing(image, Crop(7, 9, side), "photo")
    assert shown.width_height == (wanted, wanted) and shown.note == ""
    assert np.array_equal(cut_out(shown.photo, shown.crop, wanted), image[9:, 7:][:wanted, :wanted])


@pytest.mark.parametrize(("side", "wanted"), [(40, 256), (3000, MAX_SIDE)])
def test_the_photos_own_size_is_held(side, wanted):
    shown = framing(photo(60, 3000), Crop(0, 0, side), "photo")
    assert shown.width_height == (wanted, wanted)
    assert str(side) in shown.note and str(wanted) in shown.note


def test_the_whole_photo_is_even():
    image = photo(301, 403)
    shown = framing(image, Crop(50, 0, 301), full_frame=True)
    assert shown.width_height == (402, 300) and shown.note == ""
    assert np.array_equal(shown.photo, image[:300, :402])
    assert (shown.crop, shown.size) == (Crop(50, 0, 301), 301)


def test_a_very_large_photo_is_reduced_and_the_person_told():
    shown = framing(photo(3841, 1000), Crop(100, 1000, 800), full_frame=True)
    assert shown.width_height == (500, MAX_LENGTH)
    assert "1000x3841" in shown.note and "500x1920" in shown.note
    assert shown.crop == Crop(50, 500, 400)


@pytest.mark.parametrize(
    ("options", "words"), [(("300",), "256, 512, 1024, photo"), (("512", True), "give one")]
)
def test_what_cannot_be_is_refused(options, words):
    with pytest.raises(BadInput, match=words):
        framing(photo(300, 300), Crop(0, 0, 300), *options)
