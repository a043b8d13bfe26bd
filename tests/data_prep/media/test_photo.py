"""Photos: upright RGB from every kind of picture; everything else refused in one line."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from data_prep.errors import BadInput
from data_prep.media.photo import read_photo

SHARED = Path(__file__).resolve().parents[3].parent / "shared" / "data" / "photo"
RAMP = np.arange(48 * 64, dtype=np.uint32).reshape(48, 64)


def colours() -> np.ndarray:
    """A 48x64 picture whose every corner differs."""
    return np.stack([RAMP % 256, RAMP // 16, 255 - RAMP // 16], axis=2).astype(np.uint8)


def test_rgb_comes_back(tmp_path: Path) -> None:
    Image.fromarray(colours()).save(tmp_path / "a.png")
    read = read_photo(tmp_path / "a.png")
    assert read.dtype == np.uint8 and read.flags.writeable
    np.testing.assert_array_equal(read, colours())


@pytest.mark.parametrize(
    ("orientation", "stored"),
    [(3, np.rot90(colours(), 2)), (6, np.rot90(colours(), 1)), (8, np.rot90(colours(), -1))],
)
def test_exif_orientation_is_applied(tmp_path: Path, orientation: int, stored: np.ndarray) -> None:
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.fromarray(np.ascontiguousarray(stored)).save(tmp_path / "a.png", exif=exif)
    np.testing.assert_array_equal(read_photo(tmp_path / "a.png"), colours())


def test_grey_and_sixteen_bits_become_rgb(tmp_path: Path) -> None:
    grey = (RAMP // 16).astype(np.uint8)
    Image.fromarray(grey).save(tmp_path / "grey.png")
    Image.fromarray(grey.astype(np.uint16) * 257).save(tmp_path / "deep.png")
    for name in ("grey.png", "deep.png"):
        np.testing.assert_array_equal(
            read_photo(tmp_path / name), np.repeat(grey[..., None], 3, axis=2)
        )


def test_transparency_lies_on_mid_grey(tmp_path: Path) -> None:
    rgba = np.zeros((48, 64, 4), np.uint8)
    rgba[:, :20] = (200, 100, 0, 255)
    rgba[:, 40:] = (255, 255, 255, 128)
    Image.fromarray(rgba).save(tmp_path / "a.png")
    read = read_photo(tmp_path / "a.png").astype(int)
    np.testing.assert_array_equal(read[0, 0], (200, 100, 0))
    np.testing.assert_array_equal(read[0, 30], (128, 128, 128))
    np.testing.assert_allclose(read[0, 63], 128 + 127 * 128 / 255, atol=1)


def test_bad_photos_are_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "empty.png").touch()
    (tmp_path / "text.jpg").write_text("no picture")
    noise = np.random.default_rng(0).integers(0, 255, (99, 99, 3), dtype=np.uint8)
    Image.fromarray(noise).save(tmp_path / "whole.png")
    (tmp_path / "cut.png").write_bytes((tmp_path / "whole.png").read_bytes()[:5000])
    Image.fromarray(noise[:8]).save(tmp_path / "tiny.png")
    for name, reason in {
        "missing.png": "no such file",
        ".": "is a folder",
        "empty.png": "0 bytes",
        "text.jpg": "not a picture",
        "cut.png": "damaged",
        "tiny.png": "only 99x8",
    }.items():
        with pytest.raises(BadInput, match=reason) as caught:
            read_photo(tmp_path / name)
        assert "\n" not in str(caught.value)


@pytest.mark.skipif(not SHARED.is_dir(), reason="the real photos are not here")
def test_real_photos() -> None:
    turned = read_photo(SHARED / "derived_obama_exif6.jpg")
    assert turned.shape[0] > turned.shape[1]
    assert read_photo(SHARED / "obama_podium_rgba.png").shape == (1200, 626, 3)
    assert read_photo(SHARED / "derived_astronaut_gray.png").shape[2] == 3
