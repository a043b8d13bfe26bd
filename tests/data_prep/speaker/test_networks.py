"""Networks of the user's own files: what is refused, and BlazeFace on faces where it is there."""

from pathlib import Path

import numpy as np
import pytest

from data_prep.errors import BadInput
from data_prep.media.photo import read_photo
from data_prep.speaker.faces import find_people
from data_prep.speaker.networks import (
    FACE,
    HAND,
    POSE,
    _anchors,
    _groups,
    detect_faces,
    load_network,
)

SHARED = Path(__file__).resolve().parents[3].parent / "shared"
PHOTO = Path(__file__).resolve().parents[3] / "angie" / "default" / "photo.png"
with_models = pytest.mark.skipif(not (SHARED / "models").is_dir(), reason="needs the networks")


@pytest.mark.parametrize("content", [None, b"", b"<html></html>", bytes(5000)])
def test_a_folder_without_the_network_or_with_another_file_is_refused(tmp_path, content):
    if content is not None:
        (tmp_path / FACE.file).write_bytes(content)
    with pytest.raises(BadInput, match=FACE.file) as error:
        load_network(tmp_path, FACE)
    assert "\n" not in str(error.value)


def test_no_folder(tmp_path):
    with pytest.raises(BadInput, match="no such folder"):
        load_network(tmp_path / "models", FACE)


@with_models
def test_another_network_under_the_name_is_refused(tmp_path):
    (tmp_path / FACE.file).write_bytes((SHARED / "models" / HAND.file).read_bytes())
    with pytest.raises(BadInput):
        load_network(tmp_path, FACE)


def test_anchors_are_two_in_cells_of_8_pixels_then_six_in_cells_of_16():
    anchors = _anchors()
    assert anchors.shape == (896, 2)
    np.testing.assert_allclose(anchors[:3] * 128, [[4, 4], [4, 4], [12, 4]])
    np.testing.assert_allclose(anchors[32] * 128, [4, 12])
    np.testing.assert_allclose(anchors[[512, 517, 518]] * 128, [[8, 8], [8, 8], [24, 8]])


def test_boxes_that_overlap_show_one_face():
    centres = np.array([[0.5, 0.5], [0.1, 0.1], [0.52, 0.5]])
    groups = _groups(centres, np.full((3, 2), 0.2), np.array([0.8, 0.7, 0.9]))
    assert [group.tolist() for group in groups] == [[2, 0], [1]]


@with_models
@pytest.mark.parametrize("kind", [FACE, POSE, HAND])
def test_each_network_gives_what_its_kind_says(kind):
    values = load_network(SHARED / "models", kind)(np.zeros((kind.side, kind.side, 3)))
    assert [value.size for value in values] == list(kind.outputs.values())


@with_models
@pytest.mark.parametrize("photo", [PHOTO, SHARED / "data" / "photo" / "two_people.jpg"])
def test_blazeface_finds_the_boxes_of_the_cascades(photo):
    picture = read_photo(photo)
    network = load_network(SHARED / "models", FACE)
    seen, known = detect_faces(network, picture), find_people(picture)
    assert len(seen) == len(known)
    for face in seen:
        near = min(known, key=lambda one: abs(one.centre_x - face.centre_x))
        assert face.frontal
        assert abs(face.h / near.h - 1) < 0.12
        assert abs(face.centre_y - near.centre_y) < 0.12 * near.h
        assert abs(face.centre_x - near.centre_x) < 0.12 * near.h
    small = picture[::4, ::4]
    assert len(detect_faces(network, small)) == len(seen)
