"""The picture: background, body, head, desk, arms and hands put together, frame by frame."""

import cv2
import numpy as np
from numpy.typing import NDArray

from data_prep.phantom import limbs, scene
from data_prep.phantom.head import HEAD, Head
from data_prep.phantom.limbs import Hand, draw_hand
from data_prep.phantom.paint import Array, Canvas, cloth
from data_prep.phantom.presenters import Presenter, Setting
from data_prep.phantom.skeleton import (
    SIDES,
    Course,
    Joints,
    body_transform,
    head_transform,
    joints,
    to_picture,
)
from data_prep.phantom.torso import TILE_DENSITY, TORSO, torso

HEIGHT, WIDTH = scene.HEIGHT, scene.WIDTH
_REACH = {"long": 1.96, "rolled": 1.45, "short": 0.55}
_LOOSE = {"blazer": 1.14, "sweater": 1.12, "shirt": 1.08}
_GRAINS = 5


def _paste(picture: Array, sprite: NDArray[np.uint8], matrix: NDArray) -> None:
    """Lay a sprite over the picture (3, H, W) by an affine (2, 3) from sprite to picture pixels."""
    h, w = sprite.shape[:2]
    corners = np.array([[0, 0, 1], [w, 0, 1], [0, h, 1], [w, h, 1]]) @ matrix.T
    where = limbs.region(corners, 1, *picture.shape[1:])
    if where is None:
        return
    moved = matrix.copy()
    moved[:, 2] -= (where.columns.start, where.rows.start)
    size = (where.x.shape[1], len(where.y))
    *colours, alpha = cv2.split(cv2.warpAffine(sprite, moved, size, flags=cv2.INTER_LINEAR))
    mask = alpha * np.float32(1 / 255)
    for plane, colour in zip(picture, colours, strict=True):
        view = plane[where.rows, where.columns]
        view += (colour - view) * mask


def planar(image: Array) -> Array:
    """An image (H, W, 3) as contiguous planes (3, H, W)."""
    return np.ascontiguousarray(image.transpose(2, 0, 1), np.float32)


def _premask(sprite: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Spread the colours of a sprite beyond its edge so that resampling does not darken it."""
    colour = sprite[..., :3].copy()
    empty = (sprite[..., 3] < 8).astype(np.uint8)
    if 0 < empty.sum() < empty.size:
        weight = cv2.GaussianBlur(1.0 - empty.astype(np.float32), (0, 0), 4)
        full = colour.astype(np.float32) * (1 - empty)[..., None]
        spread = cv2.GaussianBlur(full, (0, 0), 4) / np.maximum(weight, 1e-3)[..., None]
        colour = np.where(empty[..., None] > 0, np.clip(spread, 0, 255), colour).astype(np.uint8)
    return np.dstack([colour, sprite[..., 3]])


class Figure:
    """A presenter in a setting, ready to be drawn in any pose of a course.

    Args:
        who: the presenter.
        place: clothes, background and light.
        course: pose of T frames.
        seed: of everything drawn at random (textures, wrinkles, background, grain).
        scale: pixels drawn for each pixel of the usual picture, along each side; the background
            is enlarged, body, head, arms and hands are drawn finer, the grain is left out above 1.
    """

    def __init__(
        self, who: Presenter, place: Setting, course: Course, seed: list[int], scale: int = 1
    ) -> None:
        rng = np.random.default_rng(seed)
        self.who, self.place, self.course, self.scale = who, place, course, scale
        first, second = np.asarray(place.first), np.asarray(place.second)
        contrast = 0.75 if place.garment == "blazer" else 1.0
        tile = cloth(rng, place.pattern, first, second, contrast)
        self.tile = (tile * 255).astype(np.float32)
        self.torso = _premask(torso(who.look, place, tile, rng))
        self.head = Head(who.look, place, rng)
        self.back = _premask(self.head.back) if self.head.back.any() else None
        lens = scene.lens(place, rng)
        self.lens = self._layer(lens)
        self.ground = self._layer(scene.background(place, rng) * 255)
        self.desk = self._layer(scene.desk(place, rng) * 255) if place.seated else None
        self.grain = [
            (rng.standard_normal((HEIGHT, WIDTH)) * place.grain).astype(np.float32)
            for _ in range(_GRAINS)
        ]
        self.joints: Joints = joints(course, who.look, place, WIDTH)
        self._body, self._head = body_transform(course), head_transform(course)
        x, y = HEAD.grid()
        dome = np.sqrt(np.maximum(0, 1 - (x / 44) ** 2 - ((y - 2) / 58) ** 2))
        self._dome = (dome * 30 * HEAD.density).astype(np.float32)
        self._relief = cv2.GaussianBlur(self._dome, (0, 0), 5)
        covered = np.nonzero(self._relief.max(1) > 0.05)[0]
        self._domed = slice(int(covered[0]), int(covered[-1]) + 1)
        self._row, self._column = np.mgrid[0 : HEAD.shape[0], 0 : HEAD.shape[1]].astype(np.float32)

    def _layer(self, image: Array) -> Array:
        """A still layer (h, w, 3) as planes (3, scale * h, scale * w)."""
        if self.scale == 1:
            return planar(image)
        size = (self.scale * image.shape[1], self.scale * image.shape[0])
        return planar(
            np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_CUBIC), np.float32)
        )

    def _placed(self, points: NDArray) -> NDArray:
        """Points (..., 2) of the usual picture as points of this one; pixel centres are whole."""
        return (points + 0.5) * self.scale - 0.5

    def _matrix(self, canvas: Canvas, transform: NDArray) -> NDArray:
        """Affine (2, 3) from sprite pixels on a canvas to frame pixels."""
        d = canvas.density
        units = np.array(
            [[1 / d, 0, canvas.x0 + 0.5 / d], [0, 1 / d, canvas.y0 + 0.5 / d], [0, 0, 1]]
        )
        origin = to_picture(np.zeros(2), np.ones(()), self.place, WIDTH)
        z = self.place.zoom
        picture = np.array([[z, 0, origin[0]], [0, z, origin[1]]])
        matrix = picture @ np.concatenate([transform, [[0.0, 0.0, 1.0]]]) @ units
        matrix[:, 2] = self._placed(matrix[:, 2])
        matrix[:, :2] *= self.scale
        return matrix

    def _turned(self, sprite: NDArray[np.uint8], yaw: float, pitch: float) -> NDArray[np.uint8]:
        """The head's sprite with its middle shifted as a turned dome would be."""
        rows = self._domed
        map_x = self._column[rows] - np.float32(np.sin(yaw)) * self._relief[rows]
        map_y = self._row[rows] - np.float32(np.sin(pitch)) * self._relief[rows]
        out = sprite.copy()
        out[rows] = cv2.remap(sprite, map_x, map_y, cv2.INTER_LINEAR)
        return out

    def _arm(self, picture: Array, t: int, side: int) -> None:
        look, place, course = self.who.look, self.place, self.course
        own = slice(4 + 4 * side, 8 + 4 * side)
        points = self._placed(self.joints.points[t, own])
        depth = self.joints.depth[t, own] * place.zoom * self.scale
        offset = (-18 * self.scale * place.light[0], self.scale * (8 - 6 * place.light[1]))
        limbs.shadow(picture, points, 17 * look.girth * self.scale, offset, 0.34)
        radii = np.array([15.5, 14.5 * look.girth, 9.6 * look.girth], np.float32) * depth[:3]
        skin = (255 * look.skin[0], 255 * look.skin[1], 255 * look.skin[2])
        loose = _LOOSE.get(place.garment, 1.05)
        sleeve = limbs.Sleeve(
            self.tile, TILE_DENSITY, _REACH[place.sleeve], skin, loose, self.scale
        )
        limbs.arm(picture, points[:3], self.joints.sleeve[t, side], radii, sleeve, place.light)
        hand = Hand(
            wrist=points[2],
            angle=float(course.angle[t, side]),
            scale=float(depth[2]) * (0.96 + 0.1 * look.girth),
            shape=course.shape[t, side],
            turn=float(course.turn[t, side] * -SIDES[side]),
            fore=float(course.fore[t, side]),
        )
        draw_hand(picture, hand, skin, place.light)

    def frame(self, t: int) -> NDArray[np.uint8]:
        """Picture t of the course, (scale * HEIGHT, scale * WIDTH, 3) uint8 RGB."""
        picture = self.ground.copy()
        head = self._matrix(HEAD, self._head[t])
        if self.back is not None:
            _paste(picture, self.back, head)
        _paste(picture, self.torso, self._matrix(TORSO, self._body[t]))
        yaw, pitch = float(self.course.head[t, 0]), float(self.course.head[t, 1])
        closed, lift, gap, width = (float(v) for v in self.course.face[t])
        sprite = self.head.sprite(closed, lift, gap, width)
        _paste(picture, self._turned(sprite, yaw, pitch), head)
        if self.desk is not None:
            picture[:, self.scale * scene.DESK_ROW :] = self.desk
        for side in (1, 0) if self.who.style.right_hand >= 0.5 else (0, 1):
            self._arm(picture, t, side)
        return self._developed(picture, t)

    def _developed(self, picture: Array, t: int) -> NDArray[np.uint8]:
        """The picture (3, H, W) through lens and sensor, (H, W, 3) uint8."""
        picture *= self.lens
        if self.scale == 1:
            picture += self.grain[t % _GRAINS]
        whole = cv2.merge([cv2.convertScaleAbs(plane) for plane in picture])
        window = (2 * self.scale + 1, 2 * self.scale + 1)
        return cv2.GaussianBlur(whole, window, self.place.blur * self.scale)
