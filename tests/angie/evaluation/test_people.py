"""People in pictures: boxes, hands at their place, faces; with networks that see what is drawn."""

import numpy as np
import pytest

from angie.evaluation import people
from angie.evaluation.people import PeopleJudge, box_around, pixel_errors, scores_of
from angie.evaluation.space import FrameTruth

RIGHT, LEFT = (60.0, 200.0), (190.0, 200.0)
"""Where `sees_white` sees hands."""


@pytest.fixture
def judge(monkeypatch, sees_white):
    monkeypatch.setattr(people, "People", sees_white)
    return PeopleJudge("anywhere")


def drawn(*hands):
    frame = np.zeros((256, 256, 3), np.uint8)
    for x, y in hands:
        frame[int(y) - 8 : int(y) + 8, int(x) - 8 : int(x) + 8] = 255
    return frame


def test_boxes_lie_around_what_is_in_the_frame():
    assert box_around(np.array([100.0, 60.0])) == (slice(36, 84), slice(76, 124))
    assert box_around(np.array([10.0, 60.0])) == (slice(36, 84), slice(0, 48))
    assert box_around(np.array([2.0, 60.0])) is box_around(np.array([np.nan, 60.0])) is None


def test_errors_in_boxes_are_those_of_the_pixels_there():
    true, made = drawn(), drawn()
    made[100:148, 100:148] = 51  # the box around (124, 124), an error of 0.2
    into = {}
    pixel_errors(made, true, np.array([[124.0, 124], [300, 300], [30, 30]]), into)
    assert into["l1_hands"] == pytest.approx([0.2]) and into["l1_face"] == [0]
    assert into["psnr_hands"] == pytest.approx([-20 * np.log10(0.2)])
    assert into["l1"] == pytest.approx([0.2 * 48**2 / 256**2])


def test_a_lost_hand_counts_as_not_seen_and_one_that_was_hidden_does_not_count(judge):
    into = {}
    judge.compare(drawn(RIGHT), judge.look(drawn(RIGHT, LEFT)), into)
    assert into["seen"] == [100, 0]
    judge.compare(drawn(RIGHT, LEFT), judge.look(drawn(LEFT)), into)
    assert into["seen"] == [100, 0, 100]
    scores = scores_of(into)
    assert scores["seen"].value == pytest.approx(200 / 3) and scores["seen"].counts == {"of": 3}
    assert "true finger tips" in scores["tips"].reason and scores["seen_folded"].value is None


def test_the_truth_counts_before_what_is_seen(judge):
    hands = np.array([RIGHT, LEFT])
    tips = np.repeat(hands[:, None] + [3.0, 4.0], 5, axis=1)
    near = np.array([[100.0, 200], [120, 200], [128, 70]])  # the truth says that they are folded
    seen = judge.look(drawn(RIGHT, LEFT), truth=FrameTruth(near, hands - [0, 6], tips))
    into = {}
    judge.compare(drawn(RIGHT, LEFT), seen, into)
    assert into["seen_folded"] == [100, 100] and "tips" not in into
    assert into["wrist"] == pytest.approx([6, 6])
    apart = FrameTruth(np.array([RIGHT, LEFT, (128, 70)]), hands, tips)
    judge.compare(drawn(), judge.look(drawn(RIGHT, LEFT), truth=apart), into)
    assert into["tips"] == pytest.approx([5, 5])  # the middles lie 3 and 4 pixels beside the tips
