"""From the course of a presenter's pose to joints: body transform and two-bone arms.

Body coordinates are in units about the pit of the neck at rest: x right, y down, z towards the
viewer. Sides are the presenter's own: the right hand is on the left of the picture. Index 0 is
the right side, index 1 the left.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_prep.phantom.paint import Array
from data_prep.phantom.presenters import Look, Setting

JOINTS = (
    "crown", "nose", "chin", "neck", "right_shoulder", "right_elbow", "right_wrist",
    "right_hand", "left_shoulder", "left_elbow", "left_wrist", "left_hand",
)  # fmt: skip
"""Names of the joints, in the order of every array of joints."""

SIDES = np.array([-1.0, 1.0], np.float32)
"""Sign of x of the presenter's right and left side."""

UPPER_ARM, FOREARM, PALM = 124.0, 108.0, 30.0
_PIVOT = np.array([0.0, 190.0])
_NECK = np.array([0.0, -24.0])
_CAMERA = 950.0
_NECK_ROW = 159.0


@dataclass(frozen=True)
class Course:
    """The pose of a presenter in each of T frames."""

    sway: Array  # (T, 2) shift of the body, units
    lean: Array  # (T,) rotation of the body, radians
    head: Array  # (T, 3) yaw, pitch, roll, radians
    wrists: Array  # (T, 2, 3) right and left, units about the neck at rest
    angle: Array  # (T, 2) direction of the fingers, radians from x towards y
    turn: Array  # (T, 2) see `hand.Hand`
    fore: Array  # (T, 2)
    shape: Array  # (T, 2, 6)
    face: Array  # (T, 4) eyelids, brows, mouth gap, mouth width


@dataclass(frozen=True)
class Joints:
    """Joints of T frames in pixels of the picture."""

    points: Array  # (T, 12, 2), as JOINTS
    depth: Array  # (T, 12) scale of perspective, 1 at the body
    sleeve: Array  # (T, 2, 2) apparent length of upper arm and forearm, units

    @property
    def frames(self) -> int:
        """T."""
        return len(self.points)


def elbow(shoulder: NDArray, wrist: NDArray, side: NDArray) -> tuple[NDArray, NDArray]:
    """Elbow and reachable wrist, (..., 3) each, of an arm that aims at `wrist`.

    Two-bone inverse kinematics by the law of cosines; the elbow hangs down, out and back.

    Args:
        shoulder: (..., 3).
        wrist: (..., 3) target.
        side: (...,) -1 for the presenter's right arm, 1 for the left.
    """
    aim = wrist - shoulder
    distance = np.linalg.norm(aim, axis=-1, keepdims=True)
    reach = np.clip(distance, abs(UPPER_ARM - FOREARM) + 25, 0.985 * (UPPER_ARM + FOREARM))
    direction = aim / np.maximum(distance, 1e-6)
    pole = np.stack([0.55 * side, np.full_like(side, 1.0), np.full_like(side, -0.45)], -1)
    pole = pole - direction * (pole * direction).sum(-1, keepdims=True)
    pole = pole / np.linalg.norm(pole, axis=-1, keepdims=True)
    forward = (reach**2 + UPPER_ARM**2 - FOREARM**2) / (2 * reach)
    out = np.sqrt(np.maximum(UPPER_ARM**2 - forward**2, 0))
    return shoulder + direction * forward + pole * out, shoulder + direction * reach


def body_transform(course: Course) -> NDArray:
    """Affine (T, 2, 3) from body units at rest to body units as swayed and leaned."""
    cos, sin = np.cos(course.lean), np.sin(course.lean)
    turn = np.stack([np.stack([cos, -sin], -1), np.stack([sin, cos], -1)], -2)
    shift = _PIVOT + course.sway - turn @ _PIVOT
    return np.concatenate([turn, shift[..., None]], -1)


def head_transform(course: Course) -> NDArray:
    """Affine (T, 2, 3) from units about the middle of the head to body units."""
    body = body_transform(course)
    roll = course.lean + course.head[:, 2]
    cos, sin = np.cos(roll), np.sin(roll)
    turn = np.stack([np.stack([cos, -sin], -1), np.stack([sin, cos], -1)], -2)
    neck = body[:, :, :2] @ _NECK + body[:, :, 2]
    lift = np.stack([7 * np.sin(course.head[:, 0]), 7 * np.sin(course.head[:, 1])], -1)
    centre = neck + lift + turn @ np.array([0.0, -54.0])
    return np.concatenate([turn, centre[..., None]], -1)


def to_picture(points: NDArray, depth: NDArray, place: Setting, width: int) -> NDArray:
    """Body units (..., 2) with perspective (...,) to pixels (..., 2) of a picture."""
    origin = np.array([width / 2 + place.position, _NECK_ROW])
    return origin + place.zoom * points * depth[..., None]


def joints(course: Course, look: Look, place: Setting, width: int) -> Joints:
    """All joints of a course, in pixels of a picture `width` wide.

    Args:
        course: pose of T frames.
        look: gives the width of the shoulders.
        place: gives position and zoom.
        width: of the picture, pixels.
    """
    frames = len(course.lean)
    body, head = body_transform(course), head_transform(course)
    out = np.zeros((frames, len(JOINTS), 3))
    yaw, pitch = course.head[:, 0], course.head[:, 1]
    for index, (x, y, bulge) in enumerate([(0, -50, 0), (0, 18, 30), (0, 50, 14)]):
        point = np.stack([x + bulge * np.sin(yaw), y + bulge * np.sin(pitch)], -1)
        out[:, index, :2] = (head[:, :, :2] @ point[..., None])[..., 0] + head[:, :, 2]
    out[:, 3, :2] = body[:, :, 2]
    for hand, side in enumerate(SIDES):
        first = 4 + 4 * hand
        rest = np.array([side * look.shoulders, 26.0])
        out[:, first, :2] = body[:, :, :2] @ rest + body[:, :, 2]
        target = course.wrists[:, hand].astype(np.float64).copy()
        target[:, 0] += course.sway[:, 0] * 0.6
        bent, reached = elbow(out[:, first], target, np.full(frames, side))
        out[:, first + 1], out[:, first + 2] = bent, reached
        angle = course.angle[:, hand]
        along = np.stack([np.cos(angle), np.sin(angle)], -1) * (PALM * course.fore[:, hand, None])
        out[:, first + 3] = reached
        out[:, first + 3, :2] += along
    depth = 1 / (1 - out[..., 2] / _CAMERA)
    flat = out[..., :2]
    upper = np.linalg.norm(flat[:, [5, 9]] - flat[:, [4, 8]], axis=-1)
    fore = np.linalg.norm(flat[:, [6, 10]] - flat[:, [5, 9]], axis=-1)
    return Joints(
        to_picture(flat, depth, place, width).astype(np.float32),
        depth.astype(np.float32),
        np.stack([upper, fore], -1).astype(np.float32),
    )
