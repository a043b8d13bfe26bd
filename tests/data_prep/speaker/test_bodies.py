"""Points that networks see in turned squares of a picture, in pixels of the picture."""

import numpy as np
import pytest

from data_prep.speaker import people as module
from data_prep.speaker.networks import FACE, HAND, POSE
from data_prep.speaker.people import People, Pose


def outputs(kind, points, score):
    """What a network of this kind says of points in pixels of its crop."""
    if kind is POSE:
        rows = np.zeros((39, 5), np.float32)
        rows[:, :2] = points
        rows[:, 3] = 9.0  # a logit: surely visible
        return [rows.reshape(1, 195), np.ones((1, 1))]
    rows = np.zeros((21, 3), np.float32)
    rows[:, :2] = points
    return [rows.reshape(1, 63), np.full((1, 1), score), np.zeros((1, 1))]


@pytest.fixture
def people(monkeypatch):
    places = {POSE.file: (128.0, 64.0), HAND.file: (112.0, 56.0)}

    def load(folder, kind):
        return lambda picture: outputs(kind, places.get(kind.file), 0.75)

    monkeypatch.setattr(module, "load_network", load)
    monkeypatch.setattr(module, "detect_faces", lambda network, image: [])
    return People("anywhere")


def test_points_come_back_from_upright_and_turned_squares(people):
    image = np.zeros((400, 400, 3), np.uint8)
    middle = np.array([200.0, 100.0])
    upright = people.pose_at(image, (middle, 256.0, 0.0))
    assert upright.points[0] == pytest.approx([200, 36]) and upright.visible[0] > 0.99
    # a square of half the side that is turned by 90 degrees: its upper edge is at the right
    turned = people.pose_at(image, (middle, 128.0, 90.0))
    assert turned.points[0] == pytest.approx([232, 100])
    hand = people.hand(image, (middle, 112.0, 0.0))
    assert hand.points[0] == pytest.approx([200, 72]) and hand.score == 0.75


def test_hands_lie_beyond_the_wrists_as_far_as_the_knuckles(people):
    points, visible = np.zeros((33, 2)), np.ones(33)
    points[[12, 11]] = (100, 100), (200, 100)
    points[16], points[20], points[18] = (100, 200), (95, 220), (105, 220)
    visible[15] = 0.2
    right, left = people.hand_squares(Pose(points, visible, (np.zeros(2), 1.0, 0.0)))
    assert left is None
    assert right[0] == pytest.approx([100, 224]) and right[1] == pytest.approx(85)
    assert right[2] == pytest.approx(180)  # the fingers point down


def test_nobody_is_nobody(people):
    assert people.pose(np.zeros((64, 64, 3), np.uint8)) is None
    assert people.face(np.zeros((64, 64, 3), np.uint8)) is None
    assert FACE.side == 128
