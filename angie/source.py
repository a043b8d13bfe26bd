"""The photo of a person, read, framed and ready to be animated.

What the video shows of the photo, and in how many pixels.

The square of a photo that is animated; imports little, so that it is found beside the rest.
"""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from angie.bundle import Bundle
from data_prep.errors import BadInput
from data_prep.media.photo import read_photo
from data_prep.rates import IMAGE_SIZE
from data_prep.speaker.crop import (
    Crop,
    check_crop,
    choose_person,
    cut_out,
    find_people,
    speaker_crop,
)
from mraa.affine import WITH_AXES
from mraa.fast.fullsize import FullSize
from mraa.renderer import Renderer, from_pixels
from mraa.training.devices import choose_precision

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


def find_crop(path: Path, person: str | None = None) -> Crop:
    """The square of a photo's file; as `photo_crop`."""
    return photo_crop(path, read_photo(path), person)


def photo_crop(
    path: Path, photo: np.ndarray, person: str | None = None, *, with_crop: bool = True
) -> Crop:
    """The square around the speaker's upper body, by the rule of the training data.

    Args:
        path: named in the message.
        photo: (H, W, 3) uint8 RGB.
        person: "left", "right" or "largest" of several people; None refuses them.
        with_crop: whether the messages advise to give the square with --crop; for commands that
            have no such option they do not.

    Raises:
        BadInput: no face is found, or several people and none is chosen.
    """
    people = find_people(photo)
    if not people:
        advice = "give the square yourself with --crop x,y,size"
        advice = advice if with_crop else "take a photo that shows one"
        raise BadInput(f"{path}: no face found; {advice}")
    if len(people) > 1 and person is None:
        advice = ", or give the square yourself with --crop x,y,size" if with_crop else ""
        raise BadInput(
            f"{path}: shows {len(people)} people; choose with --person left, right or largest"
            f"{advice}"
        )
    face = people[choose_person(people, person or "largest")]
    return speaker_crop(face, *photo.shape[:2])


def check_look(precision: str, device: str, size: str | None, full_frame: bool) -> None:
    """Refuse what the options of a video cannot mean, before anything is read.

    Raises:
        BadInput: which option, and why.
    """
    check_size(size, full_frame)
    try:
        choose_precision(precision, torch.device(device))
    except ValueError as error:
        raise BadInput(f"--precision {precision}: {error}") from error


@dataclass(frozen=True)
class Subject:
    """A photo that is ready to be animated."""

    renderer: Renderer
    picture: torch.Tensor
    """(1, 3, 256, 256) in [0, 1], the square of the photo, on the device."""
    crop: Crop
    """The square, in pixels of the upright photo."""
    shown: Framing
    """What the video shows."""
    canvas: FullSize | None
    """What draws the frames at that size; None where the renderer's own frames do."""


def open_subject(
    photo_path: Path,
    bundle: Bundle,
    *,
    device: str,
    crop: Crop | None,
    person: str | None,
    size: str | None,
    full_frame: bool,
    track_axes: bool,
) -> Subject:
    """Read a photo, find its person and load the renderer; options as in `animate`.

    Raises:
        BadInput: an input that cannot be used.
    """
    photo = read_photo(photo_path)
    if crop is None:
        crop = photo_crop(photo_path, photo, person)
    check_crop(crop, *photo.shape[:2])
    shown = framing(photo, crop, size, full_frame)
    renderer = bundle.renderer().to(device)
    if track_axes:
        if renderer.config.affine_mode not in WITH_AXES:
            mode = renderer.config.affine_mode
            raise BadInput(f"--track-axes: regions of this bundle have no axes (they are {mode})")
        renderer.flow.revert_axis_swap = False  # signs and order are meant from now on
    canvas = shown.canvas(align_corners=renderer.config.align_corners)
    if canvas is not None and not renderer.config.skips:
        raise BadInput("this bundle's renderer moves no photo; there is --size 256 alone")
    cut = torch.from_numpy(cut_out(shown.photo, shown.crop, IMAGE_SIZE))
    return Subject(renderer, from_pixels(cut[None]).to(device), crop, shown, canvas)
