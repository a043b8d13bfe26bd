"""Photos in the colours that viewers show, and what a file is that is no photo."""

import struct
import warnings

import numpy as np
import pytest
from PIL import Image, ImageCms, PngImagePlugin

from data_prep.errors import BadInput
from data_prep.media.photo import read_photo

D50 = np.array([0.9642, 1.0, 0.8249])
SRGB = np.array(
    [[0.43607, 0.38515, 0.14307], [0.22249, 0.71687, 0.06061], [0.01392, 0.09708, 0.7141]]
)
"""Primaries as columns, adapted to D50 (the numbers of the ICC's sRGB profile)."""
SPACES = {
    "P3": [[0.51512, 0.29198, 0.15710], [0.24120, 0.69225, 0.06657], [-0.00105, 0.04189, 0.78407]],
    "A98": [[0.60974, 0.20528, 0.14919], [0.31111, 0.62567, 0.06322], [0.01947, 0.06087, 0.74457]],
}  # fmt: skip
SPACES = {name: np.array(primaries) for name, primaries in SPACES.items()}


def profile(primaries: np.ndarray, gamma: float = 2.2) -> bytes:
    """A display profile of three primaries and one gamma (ICC.1:2001-04)."""
    fixed = lambda values: b"".join(struct.pack(">i", round(v * 65536)) for v in values)  # noqa: E731
    xyz = lambda values: b"XYZ \0\0\0\0" + fixed(values)  # noqa: E731
    curve = b"curv\0\0\0\0" + struct.pack(">IHH", 1, round(gamma * 256), 0)
    tags = {b"desc": b"desc\0\0\0\0" + struct.pack(">I", 2) + b"x\0" + bytes(78), b"wtpt": xyz(D50)}
    for name, column in zip("rgb", primaries.T, strict=True):
        tags[f"{name}XYZ".encode()] = xyz(column)
        tags[f"{name}TRC".encode()] = curve
    table, data = struct.pack(">I", len(tags)), b""
    for name, content in tags.items():
        table += name + struct.pack(">II", 132 + 12 * len(tags) + len(data), len(content))
        data += content.ljust(-(-len(content) // 4) * 4, b"\0")
    head = struct.pack(">I4sI4s4s4s", 0, b"lcms", 0x02100000, b"mntr", b"RGB ", b"XYZ ")
    head = head.ljust(36, b"\0") + b"acsp" + bytes(28) + fixed(D50)
    body = head.ljust(128, b"\0") + table + data
    return struct.pack(">I", len(body)) + body[4:]


def ramp() -> np.ndarray:
    """Colours well inside sRGB, so that none is clipped."""
    x, y = np.meshgrid(np.linspace(60, 190, 64), np.linspace(60, 190, 48))
    return np.stack([x, y, 250 - (x + y) / 2], axis=2).astype(np.uint8)


def as_srgb(pixels: np.ndarray, primaries: np.ndarray) -> np.ndarray:
    """What the numbers mean, by the definitions: light, XYZ, light of sRGB, sRGB."""
    light = (pixels / 255.0) ** 2.2 @ primaries.T @ np.linalg.inv(SRGB).T
    light = light.clip(0, 1)
    encoded = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return 255 * encoded


@pytest.mark.parametrize("space", SPACES)
@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.webp", "a.tif"])
def test_a_profile_is_applied(tmp_path, space, name):
    extra = {"quality": 98, "subsampling": 0} if name == "a.jpg" else {}
    extra = {"lossless": True} if name == "a.webp" else extra
    icc = profile(SPACES[space])
    Image.fromarray(ramp()).save(tmp_path / name, icc_profile=icc, **extra)
    error = np.abs(read_photo(tmp_path / name) - as_srgb(ramp(), SPACES[space]))
    assert error.mean() < 1
    assert np.abs(ramp() - as_srgb(ramp(), SPACES[space])).mean() > 2.5  # it does matter


def test_a_profile_keeps_transparency_and_palettes(tmp_path):
    icc = profile(SPACES["P3"])
    rgba = np.dstack([ramp(), np.full((48, 64), 255, np.uint8)])
    rgba[:, 40:, 3] = 0
    Image.fromarray(rgba).save(tmp_path / "a.png", icc_profile=icc)
    read = read_photo(tmp_path / "a.png")
    assert np.abs(read - as_srgb(ramp(), SPACES["P3"]))[:, :40].mean() < 1
    assert (read[:, 40:] == 128).all()
    flat = np.tile(np.array([180, 90, 70], np.uint8), (48, 64, 1))
    Image.fromarray(flat).quantize(4).save(tmp_path / "b.png", icc_profile=icc)
    assert np.abs(read_photo(tmp_path / "b.png") - as_srgb(flat, SPACES["P3"])).max() < 2


def test_srgb_and_broken_or_unfit_profiles_leave_the_pixels(tmp_path):
    srgb = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    for icc in (srgb, b"", b"nonsense", profile(SPACES["P3"])[:200], bytes(500)):
        Image.fromarray(ramp()).save(tmp_path / "a.png", icc_profile=icc)
        np.testing.assert_array_equal(read_photo(tmp_path / "a.png"), ramp())
    grey = ramp()[..., 0]
    Image.fromarray(grey).save(tmp_path / "a.png", icc_profile=profile(SPACES["P3"]))
    np.testing.assert_array_equal(read_photo(tmp_path / "a.png")[..., 0], grey)


def test_the_gamma_of_a_png_is_applied(tmp_path):
    for gamma, expected in ((1.0, 255 * (64 / 255) ** (1 / 2.2)), (1 / 2.2, 64)):
        chunk = PngImagePlugin.PngInfo()
        chunk.add(b"gAMA", struct.pack(">I", round(gamma * 100000)))
        Image.fromarray(np.full((48, 64, 3), 64, np.uint8)).save(tmp_path / "a.png", pnginfo=chunk)
        assert np.abs(read_photo(tmp_path / "a.png") - expected).max() <= 0.5


@pytest.mark.parametrize("cut", [20, 40, 60, 100])
def test_a_damaged_exif_block_is_passed_over_without_a_word(tmp_path, cut, capfd):
    exif = Image.Exif()
    exif[0x0112], exif[0x010F], exif[0x9286] = 1, "maker" * 20, b"comment" * 20
    Image.fromarray(ramp()).save(tmp_path / "a.jpg", exif=exif.tobytes()[:cut] + b"\xff" * 9)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read_photo(tmp_path / "a.jpg").shape == (48, 64, 3)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    "content, what",
    [
        (b"\0\0\0\x20ftypheic\0\0\0\0mif1heic" + bytes(100), "HEIC"),
        (b"\xff\x0a" + bytes(100), "JPEG XL"),
        (b"<svg xmlns='http://www.w3.org/2000/svg'/>", "SVG"),
        (b"%PDF-1.4\n", "PDF"),
        (b"<!doctype html>\n<html>", "web page"),
        (b"version https://git-lfs.github.com/spec/v1\n", "Git LFS pointer"),
        (b"\0\0\0\x20ftypisom\0\0\0\0isom" + bytes(100), "a video"),
        (b"ID3\x03" + bytes(100), "a recording"),
    ],
)
def test_what_is_no_photo_is_called_what_it_is(tmp_path, content, what):
    (tmp_path / "a.jpg").write_bytes(content)
    with pytest.raises(BadInput, match=what) as caught:
        read_photo(tmp_path / "a.jpg")
    assert "\n" not in str(caught.value) and str(caught.value).count(";") == 1
