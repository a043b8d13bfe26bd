"""The photo of a person: read, its square found, and framed as the video shows it.

It imports little, so that the person is found while the networks' libraries are imported.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from data_prep.errors import BadInput, check_choice
from data_prep.media.photo import photo_pixels, read_photo
from data_prep.rates import IMAGE_SIZE
from data_prep.speaker.crop import Crop, check_crop, choose_person, find_people, speaker_crop
from data_prep.speaker.networks import face_detector

if TYPE_CHECKING:
    from mraa.fast.fullsize import FullSize

Photo = Path | str | Image.Image | NDArray[np.uint8]
"""A picture file, a picture of Pillow's, or pixels (H, W, 3) uint8 RGB."""

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

    def canvas(self, *, align_corners: bool) -> "FullSize | None":
        """What draws the frames at that size; None where the renderer's own frames do.

        Args:
            align_corners: grid convention of the renderer.
        """
        if not self.whole and self.size == IMAGE_SIZE:
            return None
        from mraa.fast.fullsize import FullSize

        return FullSize(
            self.photo, self.crop, self.size, align_corners=align_corners, whole=self.whole
        )


@dataclass(frozen=True)
class View:
    """Which part of a photo moves, and what the video shows of it.

    Attributes:
        crop: the square to animate, in pixels of the upright photo; None finds it by the face.
        person: "left", "right" or "largest" where the photo shows several people; None refuses
            such photos.
        size: "256", "512", "1024" or "photo": pixels of the video's side, 256 where None; above
            256 the photo's own pixels are moved.
        full_frame: the video shows the whole photo, in its own pixels.
        models: folder of networks that see people (`data_prep.speaker.networks`), whose one for
            faces is used; None finds them by OpenCV's cascades alone.
        track_axes: follow the axes of regions from frame to frame, see `mraa.affine.track_axes`;
            not in MRAA.
    """

    crop: Crop | None = None
    person: str | None = None
    size: str | None = None
    full_frame: bool = False
    models: Path | None = None
    track_axes: bool = False

    def __post_init__(self) -> None:
        check_size(self.size, self.full_frame)


def frame_photo(photo: Photo, view: View) -> tuple[Framing, Crop]:
    """Read a photo and find its person: the photo as it is animated, and its square.

    Raises:
        BadInput: a photo that cannot be used.
    """
    if isinstance(photo, str | Path):
        path, pixels = Path(photo), read_photo(Path(photo))
    else:
        path, pixels = Path("photo"), photo_pixels(photo)
    crop = view.crop
    if crop is None:
        crop = photo_crop(path, pixels, view.person, models=view.models)
    check_crop(crop, *pixels.shape[:2])
    return framing(pixels, crop, view.size, view.full_frame), crop


def check_size(size: str | None, full_frame: bool) -> None:
    """Refuse what `--size` and `--full-frame` cannot mean.

    Raises:
        BadInput: an unknown size, or a size for the whole photo.
    """
    if size is not None:
        check_choice("--size", size, SIZES)
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


def find_crop(path: Path, person: str | None = None, models: Path | None = None) -> Crop:
    """The square of a photo's file; as `photo_crop`."""
    return photo_crop(path, read_photo(path), person, models=models)


def photo_crop(
    path: Path,
    photo: np.ndarray,
    person: str | None = None,
    *,
    with_crop: bool = True,
    models: Path | None = None,
) -> Crop:
    """The square around the speaker's upper body, by the rule of the training data.

    Args:
        path: named in the message.
        photo: (H, W, 3) uint8 RGB.
        person: "left", "right" or "largest" of several people; None refuses them.
        with_crop: whether the messages advise to give the square with --crop; for commands that
            have no such option they do not.
        models: folder with the network that finds faces, None for the cascades alone.

    Raises:
        BadInput: no face is found, or several people and none is chosen.
    """
    people = find_people(photo, face_detector(models))
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
