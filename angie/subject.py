"""The photo of a person, read, framed and ready to be animated."""

from dataclasses import dataclass
from pathlib import Path

import torch

from angie.bundle import Bundle
from angie.framing import Framing, check_size, framing
from angie.photo_crop import photo_crop
from data_prep.errors import BadInput
from data_prep.photo import read_photo
from data_prep.rates import IMAGE_SIZE
from data_prep.speaker import Crop, check_crop, cut_out
from mraa.affine import WITH_AXES
from mraa.fullsize import FullSize
from mraa.precision import choose_precision
from mraa.renderer import Renderer, from_pixels


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
