"""Where a video cuts, fades and flashes: shots, found while its frames go by once."""

from collections import deque
from dataclasses import dataclass

import cv2
import numpy as np

THUMBNAIL = (64, 36)
"""Width and height at which pictures are compared."""

_BLOCKS = (6, 8)
"""Rows and columns of blocks; a change is everywhere when it is in many of them."""

_CUT_CHANGE, _CUT_SHARE = 8.0, 0.4
"""Mean grey levels, and part of the blocks, by which a cut to another scene changes a picture."""

_BLOCK_CHANGE = 8.0
"""Mean grey levels that make a block changed."""

_CUT_RATIO = 3.0
"""How far a cut stands above the changes around it."""

_JUMP_CHANGE, _JUMP_RATIO = 2.0, 6.0
"""The same for a jump within a scene: less change, but standing out further."""

_AROUND = 8
"""Pictures on either side from which the usual change is estimated."""

_USUAL = 0.75
"""Quantile of the changes around; above a half, as sources may repeat every other picture."""

_REACHES = (5, 10, 20)
"""Frames to either side between which a fade is sought."""

_FADE_CHANGE, _FADE_SHARE = 14.0, 0.6
_FADE_BEND = 0.3
"""In a fade the middle is the mean of both sides, but for this part of the change."""

_MARGIN = 2
_LATE = (1 - _FADE_BEND) / (1 + _FADE_BEND)
"""Part of the reach by which the beginning of a fade is missed: there one side stands still,
and with a step of j into the fade the bend is (reach - j) / (reach + j)."""

_BETWEEN = 12
"""Frames between two fades below which they are one: out to black and in again."""


@dataclass(frozen=True)
class Shot:
    """Frames without a break.

    Attributes:
        first: its first frame.
        stop: one past its last frame.
        faded: whether it is no shot but a fade or flash between two.
    """

    first: int
    stop: int
    faded: bool = False


def _block_means(picture: np.ndarray) -> np.ndarray:
    rows, columns = _BLOCKS
    width, height = THUMBNAIL
    return picture.reshape(rows, height // rows, columns, width // columns).mean(axis=(1, 3))


class ShotDetector:
    """Compares the pictures of a video as they come; keeps small copies of the last 41 only.

    A cut changes most of the picture at once, a jump cut stands far above the changes around
    it, and in a fade (to another scene, to black or from white) every picture is the mean of
    those before and after it.
    """

    def __init__(self) -> None:
        self._recent: deque[np.ndarray] = deque(maxlen=2 * max(_REACHES) + 1)
        self._count = 0
        self._starts: list[int] = []
        self._change: list[float] = []
        self._share: list[float] = []
        self._fading: list[tuple[int, int]] = []

    def add(self, grey: np.ndarray, frames: int = 1) -> None:
        """Look at the next picture.

        Args:
            grey: `(H, W)` uint8.
            frames: for how many frames at 25 fps it is shown.
        """
        small = cv2.resize(grey, THUMBNAIL, interpolation=cv2.INTER_AREA).astype(np.float32)
        if self._recent:
            change = np.abs(small - self._recent[-1])
            self._starts.append(self._count)
            self._change.append(float(change.mean()))
            self._share.append(float((_block_means(change) > _BLOCK_CHANGE).mean()))
        for _ in range(frames):
            self._recent.append(small)
            self._count += 1
            self._look_for_fade()

    def _look_for_fade(self) -> None:
        centre = max(_REACHES)
        if len(self._recent) <= 2 * centre:
            return
        middle = self._recent[centre]
        for reach in _REACHES:
            before, after = self._recent[centre - reach], self._recent[centre + reach]
            change = np.abs(after - before)
            if change.mean() < _FADE_CHANGE:
                continue
            if (_block_means(change) > _BLOCK_CHANGE).mean() < _FADE_SHARE:
                continue
            bend = np.abs(middle - (before + after) / 2).mean() * 2 / change.mean()
            if bend < _FADE_BEND:
                self._fading.append((self._count - 1 - centre, reach))
                return

    def cuts(self) -> list[int]:
        """Frames with which a new shot begins at once, the first of the video left out."""
        change, share = np.array(self._change), np.array(self._share)
        found = []
        for i, frame in enumerate(self._starts):
            low = max(0, i - _AROUND)
            around = np.delete(change[low : i + _AROUND + 1], i - low)
            usual = float(np.quantile(around, _USUAL)) if len(around) else 0.0
            cut = change[i] > _CUT_CHANGE and share[i] > _CUT_SHARE
            jump = change[i] > max(_JUMP_CHANGE, _JUMP_RATIO * usual)
            if (cut and change[i] > _CUT_RATIO * usual) or jump:
                found.append(frame)
        return found

    def shots(self) -> list[Shot]:
        """All of the video's frames as shots and the fades between them, in order."""
        broken = np.zeros(self._count, bool)
        for frame, reach in self._fading:
            margin = _MARGIN + round(_LATE * reach)
            broken[max(0, frame - margin) : frame + margin + 1] = True
        whole = np.flatnonzero(broken)
        for a, b in zip(whole, whole[1:], strict=False):
            broken[a:b] |= b - a <= _BETWEEN
        edges = np.flatnonzero(np.diff(broken)) + 1
        bounds = sorted({0, self._count, *edges.tolist(), *self.cuts()})
        return [
            Shot(a, b, bool(broken[a])) for a, b in zip(bounds, bounds[1:], strict=False) if b > a
        ]
