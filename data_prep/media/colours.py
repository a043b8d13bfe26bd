"""Colours of a picture as a viewer shows them: what its profile or gamma says, as sRGB."""

import io

import numpy as np
from PIL import Image, ImageCms

_SPACES = {"RGB": "RGB", "RGBA": "RGB", "RGBX": "RGB", "L": "GRAY", "LA": "GRAY", "CMYK": "CMYK"}
"""Colour space of a profile that fits pictures of a mode."""

_SRGB_GAMMA = 1 / 2.2

_SAME = 2
"""Levels by which a profile may differ from sRGB to be taken for it."""


def to_srgb(image: Image.Image) -> Image.Image:
    """A picture in sRGB.

    The profile that it carries says what its numbers mean (ICC.1:2022); in a PNG without one the
    gamma does (PNG, third edition, 11.3.2). A profile that is broken, or for other channels than
    the picture has, is passed over, as viewers do.

    Args:
        image: of any mode.

    Returns:
        the picture in mode RGB, RGBA, L or LA where it was converted, else as it was.
    """
    profile, gamma = image.info.get("icc_profile"), image.info.get("gamma")
    if image.mode in ("P", "PA", "1"):
        image = image.convert("RGBA" if image.has_transparency_data else "RGB")
    if isinstance(profile, bytes) and profile:
        try:
            return _by_profile(image, ImageCms.ImageCmsProfile(io.BytesIO(profile)))
        except (ImageCms.PyCMSError, OSError, ValueError, TypeError):
            return image
    if isinstance(gamma, float) and 0.01 < gamma < 100 and "srgb" not in image.info:
        return _by_gamma(image, gamma)
    return image


def _by_profile(image: Image.Image, profile: ImageCms.ImageCmsProfile) -> Image.Image:
    if _SPACES.get(image.mode) != profile.profile.xcolor_space.strip():
        return image
    grey = image.mode in ("L", "LA")
    alpha = image.getchannel("A") if image.mode in ("RGBA", "LA") else None
    colours = image.convert({"RGBA": "RGB", "RGBX": "RGB", "LA": "L"}.get(image.mode, image.mode))
    transform = ImageCms.buildTransform(
        profile,
        ImageCms.createProfile("sRGB"),
        colours.mode,
        "RGB",
        ImageCms.Intent(ImageCms.getDefaultIntent(profile)),
        ImageCms.Flags.BLACKPOINTCOMPENSATION,
    )
    if colours.mode == "RGB" and _is_srgb(transform):
        return image
    converted = ImageCms.applyTransform(colours, transform)
    assert converted is not None
    if grey:
        converted = converted.convert("L")
    if alpha is not None:
        converted.putalpha(alpha)
    return converted


def _is_srgb(transform: ImageCms.ImageCmsTransform) -> bool:
    """Whether a transform leaves colours as they are, but for rounding."""
    levels = np.arange(0, 256, 51, dtype=np.uint8)
    grid = np.stack(np.meshgrid(levels, levels, levels), axis=-1).reshape(6, 36, 3)
    after = ImageCms.applyTransform(Image.fromarray(grid), transform)
    return bool(np.abs(np.asarray(after, np.int16) - grid).max() <= _SAME)


def _by_gamma(image: Image.Image, gamma: float) -> Image.Image:
    """Samples are light to the power of `gamma`; sRGB's are nearly light to that of 1/2.2."""
    if image.mode not in ("RGB", "RGBA", "L", "LA") or abs(gamma / _SRGB_GAMMA - 1) < 0.02:
        return image
    table = np.rint(255 * (np.arange(256) / 255) ** (_SRGB_GAMMA / gamma)).astype(int).tolist()
    same = list(range(256))
    colours = len(image.getbands()) - (image.mode in ("RGBA", "LA"))
    return image.point(table * colours + same * (len(image.getbands()) - colours))
