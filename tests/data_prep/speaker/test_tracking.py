"""Persons from sightings, and which parts of a video have one clear speaker; by hand."""

import numpy as np
import pytest

from data_prep.errors import BadInput
from data_prep.media.video import VideoInfo
from data_prep.prepare.analysis import Analysis, BarDetector
from data_prep.prepare.camera import CameraPath
from data_prep.prepare.shots import Shot
from data_prep.prepare.source import IngestionConfig
from data_prep.prepare.spans import find_takes
from data_prep.speaker.crop import Crop, choose_person
from data_prep.speaker.faces import Face, rivals
from data_prep.speaker.tracking import Sighting, jumps, link, presence

INFO = VideoInfo(1000, 600, 25.0, 20.0, True, 0.0)
LEFT, RIGHT = Face(200, 100, 80, 80), Face(700, 100, 100, 100)


def looks(frames: int, *faces: Face) -> list[Sighting]:
    return [Sighting(k, faces) for k in range(0, frames, 10)]


def analysis(sightings: list[Sighting], frames: int = 500) -> Analysis:
    matrices = np.repeat(np.eye(3)[None], frames, axis=0)
    camera = CameraPath(matrices, [0], 1000, 600)
    return Analysis(frames, [Shot(0, frames)], camera, sightings, BarDetector())


def judged(sightings: list[Sighting], **config) -> list[tuple[int, int, str | None]]:
    takes = find_takes(analysis(sightings), INFO, IngestionConfig(**config), 500)
    return [(take.span.first, take.span.stop, take.span.reason) for take in takes]


def test_a_second_face_counts_when_comparable_and_off_the_body() -> None:
    person = Face(283, 47, 85, 85)
    collar = Face(299, 128, 55, 55)
    poster = Face(600, 40, 30, 30)
    other = Face(500, 60, 60, 60)
    assert rivals([person, other, collar, poster]) == [person, other]


def test_people_are_chosen_by_place_or_size() -> None:
    faces = [RIGHT, LEFT]
    assert [choose_person(faces, who) for who in ("left", "right", "largest")] == [1, 0, 0]
    with pytest.raises(BadInput, match="left, right, largest"):
        choose_person(faces, "both")


def test_one_speaker_is_kept_whole_with_the_crop_of_the_median_face() -> None:
    sightings = looks(500, RIGHT)
    for k in range(20, 25):
        sightings[k] = Sighting(10 * k, ())  # behind a hand for 2 s
    (take,) = find_takes(analysis(sightings), INFO, IngestionConfig(), 500)
    assert (take.span.first, take.span.stop, take.span.reason) == (0, 500, None)
    assert take.span.crop == Crop(540, 37, 420) and take.span.filled == 0
    assert take.span.face == RIGHT and len(take.faces) == 45


def test_two_people_are_refused_or_one_is_chosen() -> None:
    both = looks(500, RIGHT, LEFT)
    assert judged(both) == [(0, 500, "two people")]
    for person, face in (("left", LEFT), ("right", RIGHT), ("largest", RIGHT)):
        (take,) = find_takes(analysis(both), INFO, IngestionConfig(person=person), 500)
        assert take.span.reason is None and take.span.face == face


def test_a_guest_refuses_only_the_time_of_the_visit() -> None:
    sightings = looks(500, RIGHT)
    for k in range(20, 31):
        sightings[k] = Sighting(10 * k, (RIGHT, LEFT))
    assert judged(sightings) == [(0, 200, None), (200, 301, "two people"), (301, 500, None)]


def test_a_face_seen_once_or_twice_is_nobody() -> None:
    sightings = looks(500, RIGHT)
    for k in (20, 21):
        sightings[k] = Sighting(10 * k, (RIGHT, LEFT))
    assert judged(sightings) == [(0, 500, None)]


def test_reasons_of_refusal() -> None:
    assert judged(looks(500)) == [(0, 500, "no person")]
    assert judged(looks(500, Face(400, 100, 30, 30))) == [(0, 500, "face too small")]
    aside = Face(400, 100, 90, 90, frontal=False)
    assert judged(looks(500, aside)) == [(0, 500, "not frontal")]
    away = [s for s in looks(500, RIGHT) if s.frame < 300] + [
        Sighting(k, ()) for k in range(300, 500, 10)
    ]
    assert judged(away) == [(0, 291, None), (291, 500, "no person")]


def test_a_given_crop_is_not_judged_by_people() -> None:
    crop = Crop(600, 50, 700)
    both = looks(500, RIGHT, LEFT)
    (take,) = find_takes(analysis(both), INFO, IngestionConfig(crop=crop), 500)
    assert take.span.reason is None and take.span.crop == crop and take.span.face == RIGHT
    # 400 x 550 of 700 x 700 pixels are inside.
    assert take.span.filled == pytest.approx(1 - 400 * 550 / 700**2)
    with pytest.raises(BadInput, match="outside"):
        find_takes(analysis(both), INFO, IngestionConfig(crop=Crop(1000, 0, 10)), 500)


def test_a_moving_camera_drops_or_is_undone() -> None:
    moved = analysis(looks(500, RIGHT))
    shift = np.clip(np.arange(500) - 200, 0, 100) * 0.5
    moved.camera.matrices[:, 0, 2] = shift
    steady = [
        Sighting(s.frame, (Face(700 + shift[s.frame], 100, 100, 100),)) for s in moved.sightings
    ]
    moved.sightings[:] = steady
    reasons = [take.span.reason for take in find_takes(moved, INFO, IngestionConfig(), 500)]
    assert reasons[0] is None and "camera moves" in reasons
    (take,) = find_takes(moved, INFO, IngestionConfig(stabilize=True), 500)
    assert take.reference == 250 and take.span.reason is None
    # The face stands still in the room, so in the picture of frame 250 it has been moved by 25.
    assert {face.x for _, face in take.faces} == {725.0}


def test_fades_and_what_is_short_are_refused() -> None:
    seen = analysis(looks(500, RIGHT))
    seen.shots[:] = [Shot(0, 50), Shot(50, 60, faded=True), Shot(60, 500)]
    takes = find_takes(seen, INFO, IngestionConfig(), 450)
    assert [(t.span.first, t.span.stop, t.span.reason) for t in takes] == [
        (0, 50, "shorter than 97 frames"),
        (50, 60, "a fade or flash"),
        (60, 450, None),
    ]


def test_links_gaps_and_jumps() -> None:
    walk = [Sighting(10 * k, (Face(100 + 30 * k, 100, 100, 100),)) for k in range(20)]
    (track,) = link(walk)
    assert track.face.centre_x == 100 + 30 * 9.5 + 50
    assert presence([track], 0, 400)[0].sum() == 191  # to frame 190; its end is too far away
    faces = [(0, LEFT), (10, LEFT), (20, RIGHT), (30, RIGHT)]
    assert jumps(faces)
    assert not jumps([(0, LEFT), (10, RIGHT), (20, LEFT), (30, LEFT)])  # one false hit
    assert not jumps([(10 * k, Face(100 + 50 * k, 100, 100, 100)) for k in range(9)])
