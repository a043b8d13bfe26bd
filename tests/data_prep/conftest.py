"""A drawn person, so that tests of the speaker and of whole videos need no real ones."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest

SKIN, SHADE, HAIR, COAT = (225, 180, 150), (170, 120, 95), (50, 35, 25), (50, 60, 110)


def draw_person(
    height: int = 360,
    width: int = 480,
    x: float = 240,
    y: float = 110,
    scale: float = 0.75,
    hand: float = 0.0,
) -> np.ndarray:
    """Draw a person facing the camera.

    The head's ellipse has its centre at `(x, y + 2 scale)` and half axes `(38, 50) scale`;
    `hand` from 0 to 1 lifts the right hand by 80 scale pixels.
    """
    image = np.full((height, width, 3), (120, 140, 150), np.uint8)

    def spot(dx: float, dy: float, a: float, b: float, colour: tuple[int, int, int]) -> None:
        centre = (round((x + dx * scale) * 16), round((y + dy * scale) * 16))
        axes = (round(a * scale * 16), round(b * scale * 16))
        cv2.ellipse(image, centre, axes, 0, 0, 360, colour, -1, cv2.LINE_AA, 4)

    spot(0, 190, 95, 130, COAT)
    spot(0, 50, 16, 22, SHADE)
    spot(0, -12, 46, 56, HAIR)
    spot(0, 2, 38, 50, SKIN)
    for side in (-1, 1):
        spot(side * 16, -10, 11, 6, SHADE)
        spot(side * 16, -8, 9, 4.5, (245, 245, 245))
        spot(side * 16, -8, 4.2, 4.2, (40, 30, 25))
        spot(side * 16, -19, 11, 2.6, (60, 40, 30))
        spot(side * 5, 14, 3, 2, SHADE)
    spot(0, 6, 3.5, 12, (240, 200, 175))
    spot(0, 28, 14, 3.5, (150, 70, 70))
    spot(-70, 170, 14, 18, SKIN)
    spot(70, 170 - 80 * hand, 14, 18, SKIN)
    return cv2.GaussianBlur(image, (0, 0), max(1.2 * scale, 0.6))


@pytest.fixture(scope="session")
def person() -> Callable[..., np.ndarray]:
    """The drawing function `draw_person`."""
    return draw_person
