"""The camera: pans and zooms are seen and can be undone; a moving person is none."""

import cv2
import numpy as np
import pytest

from data_prep.prepare.camera import CameraPath, CameraTracker
from data_prep.speaker.faces import Face


def room(seed: int = 0) -> np.ndarray:
    """A textured wall of 320x180."""
    rng = np.random.default_rng(seed)
    wall = cv2.resize(rng.integers(0, 255, (23, 40)).astype(np.uint8), (320, 180))
    return cv2.GaussianBlur(wall, (0, 0), 1.5)


def view(zoom: float, x: float, y: float) -> np.ndarray:
    """From a pixel of the room to where a camera shows it: zoomed about the middle, shifted."""
    return np.array([[zoom, 0, 160 * (1 - zoom) + x], [0, zoom, 90 * (1 - zoom) + y], [0, 0, 1.0]])


def follow(views: list[np.ndarray], hand: bool = False, wall: np.ndarray | None = None):
    tracker = CameraTracker()
    wall = room() if wall is None else wall
    for k, matrix in enumerate(views):
        picture = cv2.warpAffine(wall, matrix[:2], (320, 180), borderMode=cv2.BORDER_REFLECT)
        if hand:
            x = round(120 + 60 * np.sin(k / 3))
            picture[60:160, x : x + 50] = room(1)[60:160, 100:150]
        tracker.add(picture, [])
    return tracker.path()


def test_a_moving_person_is_no_moving_camera() -> None:
    path = follow([view(1, 0, 0)] * 60, hand=True)
    assert not path.moving(0, 60).any()
    assert path.travel(0, 60) < 0.003


def close_up(person: float, wall: np.ndarray, camera: float = 0.0) -> np.ndarray:
    """A head and shoulders that fill the picture, moved by pixels, before a wall."""
    shift = np.array([[1, 0, camera], [0, 1, 0.0]])
    picture = cv2.warpAffine(wall, shift, (320, 180), borderMode=cv2.BORDER_REFLECT)
    body = cv2.warpAffine(
        room(1), np.array([[1, 0, person + camera], [0, 1, 0.0]]), (320, 180), borderMode=2
    )
    mask = np.zeros((180, 320), np.uint8)
    middle = round(160 + person + camera)
    cv2.ellipse(mask, (middle, 80), (50, 65), 0, 0, 360, 1, -1)
    cv2.ellipse(mask, (middle, 200), (190, 75), 0, 0, 360, 1, -1)
    return np.where(mask, body, picture)


def test_a_close_up_before_a_plain_wall_says_nothing_of_the_camera() -> None:
    def path(wall: np.ndarray, camera: float) -> CameraPath:
        tracker = CameraTracker()
        for k in range(60):
            way = 12 * np.sin(k / 6)
            place = 160 + way + camera * k
            tracker.add(close_up(way, wall, camera * k), [Face(place - 45, 35, 90, 90)])
        return tracker.path()

    plain = np.full((180, 320), 150, np.uint8)
    assert not path(plain, 0.0).moving(0, 60).any()
    # Before a wall that shows something, both are told apart.
    assert not path(room(), 0.0).moving(0, 60).any()
    assert path(room(), 0.5).moving(0, 60).all()


def test_a_pan_is_seen_where_it_is() -> None:
    shift = np.concatenate([np.zeros(60), np.arange(50) * 0.5, np.full(60, 24.5)])
    moving = follow([view(1, x, 0) for x in shift], hand=True).moving(0, 170)
    # 12 pixels a second are 0.0375 long sides; seen within a window of a second around.
    assert moving[60:110].all()
    assert not follow([view(1, 24.5, 0)] * 60).moving(0, 60).any()


@pytest.mark.parametrize("rate", [0.02, 0.04])
def test_a_slow_zoom_is_seen(rate: float) -> None:
    path = follow([view(1.02 + rate * k / 25, 0, 0) for k in range(120)], hand=True)
    assert path.moving(0, 120).mean() > 0.9
    # The probes are 112 of 320 from the middle.
    grown = (1.02 + rate * 119 / 25) / 1.02
    assert path.travel(0, 120) == pytest.approx((grown - 1) * 112 / 320, rel=0.15)


def test_motion_is_known_well_enough_to_undo_it() -> None:
    views = [view(1 + 0.002 * k, 0.8 * k, 8 * np.sin(k / 9)) for k in range(60)]
    path = follow(views, hand=True)
    truth = views[50] @ np.linalg.inv(views[10])
    corners = np.array([[40, 30, 1], [280, 30, 1], [40, 150, 1], [280, 150, 1.0]])
    error = corners @ (path.between(10, 50) - truth).T
    assert np.abs(error[:, :2]).max() < 0.75


def test_a_cut_is_a_break() -> None:
    tracker = CameraTracker()
    for k in range(20):
        tracker.add(room(0 if k < 10 else 1), [])
        assert tracker.lost == (k in (0, 10))
    assert tracker.path().breaks == [0, 10]


def test_nothing_is_said_of_a_plain_wall() -> None:
    wall = np.full((180, 320), 90, np.uint8)
    assert not follow([view(1, x, 0) for x in range(60)], wall=wall).moving(0, 60).any()


def test_no_background_is_sought_around_faces() -> None:
    """The only texture is a person's shirt, which moves."""
    tracker = CameraTracker()
    for k in range(40):
        picture = np.full((180, 320), 90, np.uint8)
        picture[60:, 110 + k : 210 + k] = room()[60:, :100]
        tracker.add(picture, [Face(145 + k, 20, 30, 30)])
    assert not tracker.path().moving(0, 40).any()


def test_path_by_hand() -> None:
    matrices = np.repeat(np.eye(3)[None], 100, axis=0)
    matrices[50:, 0, 2] = 20.0
    path = CameraPath(matrices, [0], 1000, 500)
    assert path.travel(0, 100) == pytest.approx(0.02)
    assert path.travel(0, 50) == 0
    moving = path.moving(0, 100)
    assert list(np.flatnonzero(moving)[[0, -1]]) == [38, 61]  # 12 frames to either side
    assert path.between(10, 60) == pytest.approx(matrices[50])
