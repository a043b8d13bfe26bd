"""What the video shows of the photo, and in how many pixels."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from data_prep.errors import BadInput
from data_prep.rates import IMAGE_SIZE
from data_prep.speaker import Crop
from mraa.fullsize import FullSize

SIZES = ("256", "512", "1024", "photo")
"""Choices of the video's side; "photo" is that of the square in the photo."""

MAX_SIDE = 2048
"""Pixels of the largest square that "photo" gives."""

MAX_LENGTH = 1920
"""Pixels of the longer side of a whole photo in a video; larger ones are reduced."""


@dataclass(frozen=True)
class Framing:
    """The photo as it is animated."""

    photo: NDArray[np.uint8]
    """(H, W, 3) RGB; reduced and with even sides where the whole photo is shown."""
    crop: Crop
    """The square of `photo` that moves."""
    size: int
    """Pixels of the square's side in the video."""
    whole: bool
    """The video shows the whole photo."""
    note: str = ""
    """What the person should know, or nothing."""

    @property
    def width_height(self) -> tuple[int, int]:
        """Width and height of the video, even."""
        if self.whole:
            return self.photo.shape[1], self.photo.shape[0]
        return self.size, self.size

    def canvas(self, *, align_corners: bool) -> FullSize | None:
        """What draws the frames at that size; None where the renderer's own frames do.

        Args:
            align_corners: grid convention of the renderer.
        """
        if not self.whole and self.size == IMAGE_SIZE:
            return None
        return FullSize(
            self.photo, self.crop, self.size, align_corners=align_corners, whole=self.whole
        )


def check_size(size: str | None, full_frame: bool) -> None:
    """Refuse what `--size` and `--full-frame` cannot mean.

    Raises:
        BadInput: an unknown size, or a size for the whole photo.
    """
    if size is not None and size not in SIZES:
        raise BadInput(f"--size {size}: there are {', '.join(SIZES[:-1])} and {SIZES[-1]}")
    if size is not None and full_frame:
        raise BadInput("--size and --full-frame: give one; the whole photo keeps its own size")


def framing(
    photo: NDArray[np.uint8], crop: Crop, size: str | None = None, full_frame: bool = False
) -> Framing:
    """What the video shows.

    Args:
        photo: (H, W, 3) uint8 RGB, upright.
        crop: the square to animate, in pixels of `photo`.
        size: one of `SIZES`, 256 where None. "photo" drops an odd last pixel and is held between
            256, which the networks see, and `MAX_SIDE`.
        full_frame: show the whole photo, with the square in its place; at most `MAX_LENGTH`
            pixels long, an odd last row and column left out.

    Raises:
        BadInput: see `check_size`.
    """
    check_size(size, full_frame)
    if full_frame:
        return _whole(photo, crop)
    if size != "photo":
        return Framing(photo, crop, int(size or IMAGE_SIZE), whole=False)
    side = crop.size - crop.size % 2
    if IMAGE_SIZE <= side <= MAX_SIDE:
        return Framing(photo, Crop(crop.x, crop.y, side), side, whole=False)
    held = min(max(side, IMAGE_SIZE), MAX_SIDE)
    note = f"the square has {crop.size} pixels in the photo; the video has {held}"
    return Framing(photo, crop, held, whole=False, note=note)


def _whole(photo: NDArray[np.uint8], crop: Crop) -> Framing:
    height, width = photo.shape[:2]
    note = ""
    scale = MAX_LENGTH / max(height, width)
    if scale < 1:
        size = (round(width * scale), round(height * scale))
        photo = np.asarray(cv2.resize(photo, size, interpolation=cv2.INTER_AREA), np.uint8)
        x, y, side = (round(scale * value) for value in (crop.x, crop.y, crop.size))
        crop = Crop(x, y, max(side, 1))
    even = np.ascontiguousarray(photo[: photo.shape[0] // 2 * 2, : photo.shape[1] // 2 * 2])
    if scale < 1:
        shown = f"{even.shape[1]}x{even.shape[0]}"
        note = f"the photo is reduced from {width}x{height} to {shown} pixels"
    return Framing(even, crop, crop.size, whole=True, note=note)
