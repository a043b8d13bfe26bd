"""Photos: any picture file as upright 8-bit RGB."""

import contextlib
import logging
import struct
import warnings
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps, UnidentifiedImageError

from data_prep.errors import BadInput
from data_prep.media.colours import to_srgb
from data_prep.media.container import check_file, describe
from data_prep.media.kinds import HEIC, kind_of

logging.getLogger("PIL").addHandler(logging.NullHandler())  # what is wrong is told in one line

MIN_SIDE = 32
"""Pixels of the shorter side below which nothing can be recognised."""

_GREY = (128, 128, 128, 255)


def _to_eight_bits(image: Image.Image) -> Image.Image:
    """A 16-bit, 32-bit or float greyscale picture as 8-bit; others as they are."""
    if not image.mode.startswith(("I", "F")):
        return image
    values = np.asarray(image, np.float64)
    if image.mode.startswith("I"):
        values = values * (255 / 65535)
    elif values.max(initial=0) <= 1:
        values = values * 255
    values = np.clip(np.rint(np.nan_to_num(values)), 0, 255)
    eight = Image.fromarray(values.astype(np.uint8), "L")
    eight.info = image.info
    return eight


def read_photo(path: Path) -> np.ndarray:
    """Read a photo, turned upright by its EXIF orientation, in the colours that viewers show.

    Its colour profile is applied. Greyscale and palette pictures become RGB, transparency is laid
    over mid grey, 16-bit greyscale is scaled to 8 bits, and the first picture of an animation is
    taken.

    Args:
        path: any picture format that Pillow reads; HEIC where pillow-heif is installed.

    Returns:
        pixels `(H, W, 3)` uint8 RGB.

    Raises:
        BadInput: missing, a folder, 0 bytes, not a picture, damaged, or tiny.
    """
    path = Path(path)
    check_file(path)
    kind = kind_of(path)
    if kind == HEIC:
        _read_heic()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of damaged EXIF blocks, which are passed over
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(path) as opened:
                pixels = _upright(opened)
    except UnidentifiedImageError as error:
        what = f"but {kind}" if kind and kind != "a picture" else "that can be read"
        advice = "" if ";" in what else "; give a photo (jpg, png, webp ...)"
        raise BadInput(f"{path}: not a picture {what}{advice}") from error
    except (Image.DecompressionBombWarning, Image.DecompressionBombError) as error:
        raise BadInput(f"{path}: is too large a picture; scale it down first") from error
    except Exception as error:  # Pillow's decoders raise whatever a damaged file leads them to
        raise BadInput(
            f"{path}: the picture is damaged ({describe(error)}); copy or save it again"
        ) from error
    return _checked(pixels, str(path))


def _read_heic() -> None:
    """Let Pillow read HEIC where the package for it is installed."""
    with contextlib.suppress(ImportError):
        from pillow_heif import register_heif_opener

        register_heif_opener()


def photo_pixels(photo: Image.Image | np.ndarray) -> np.ndarray:
    """Pixels of a photo that is in memory, as `read_photo` gives them.

    Args:
        photo: a picture of Pillow's, or pixels `(H, W, 3)` uint8 RGB, upright.

    Raises:
        BadInput: another array, or a tiny picture.
    """
    if isinstance(photo, Image.Image):
        return _checked(_upright(photo), "photo")
    if not isinstance(photo, np.ndarray):
        raise BadInput(f"photo: give a file, a picture or an array, not {type(photo).__name__}")
    if photo.ndim != 3 or photo.shape[2] != 3 or photo.dtype != np.uint8:
        raise BadInput(f"photo: an array is (H, W, 3) uint8 RGB, not {photo.shape} {photo.dtype}")
    return _checked(photo, "photo")


def _upright(image: Image.Image) -> np.ndarray:
    """Pixels `(H, W, 3)` uint8 RGB of a picture, turned by its EXIF tag."""
    try:
        image = ImageOps.exif_transpose(image)
    except (OSError, ValueError, TypeError, SyntaxError, KeyError, struct.error):
        image.load()  # a damaged EXIF block says nothing of the pixels
    image = to_srgb(_to_eight_bits(image))
    if image.has_transparency_data:
        ground = Image.new("RGBA", image.size, _GREY)
        image = Image.alpha_composite(ground, image.convert("RGBA"))
    return np.array(image.convert("RGB"))


def _checked(pixels: np.ndarray, name: str) -> np.ndarray:
    if min(pixels.shape[:2]) < MIN_SIDE:
        height, width = pixels.shape[:2]
        raise BadInput(f"{name}: is only {width}x{height} pixels; give a larger photo")
    return pixels
