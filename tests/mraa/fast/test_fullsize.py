"""Frames at the photo's own resolution."""

import cv2
import numpy as np
import pytest
import torch

from data_prep.speaker.crop import Crop, cut_out
from mraa.fast.fullsize import FullSize, border_fade, taps
from mraa.flow import Flow
from mraa.generator import LiteGenerator
from mraa.grid import coordinate_grid
from mraa.renderer import from_pixels, to_pixels

SIDE = 64  # of the networks' square; the flow has a quarter of it


@pytest.fixture(scope="module")
def photo():
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 256, (14, 20, 3), dtype=np.uint8)
    coarse = cv2.resize(noise, (200, 140), interpolation=cv2.INTER_CUBIC)
    return np.clip(coarse + rng.integers(-9, 9, coarse.shape), 0, 255).astype(np.uint8)


def at_rest(count=1):
    flow = coordinate_grid(SIDE // 4, SIDE // 4).expand(count, -1, -1, -1).clone()
    return flow, torch.ones(count, 1, SIDE // 4, SIDE // 4), torch.rand(count, 3, SIDE, SIDE)


def wave(count=1):
    """Motion by several pixels, up to the borders, with places that are painted."""
    generator = torch.Generator().manual_seed(1)
    flow, occlusion, painted = at_rest(count)
    flow += 0.1 * torch.sin(7 * flow.flip(-1) + 1)
    occlusion[..., : SIDE // 8, :] = 0.5
    return flow, occlusion, torch.rand(painted.shape, generator=generator)


@pytest.mark.parametrize("corners", [True, False])
@pytest.mark.parametrize(
    ("crop", "size"),
    [(Crop(30, 20, 90), 90), (Crop(30, 20, 91), 128), (Crop(30, 20, 90), 48),
     (Crop(-20, 70, 110), 110), (Crop(-20, 70, 110), 256)],
)  # fmt: skip
def test_at_rest_the_photo_itself_is_drawn(photo, crop, size, corners):
    flow, _, painted = at_rest(2)
    frames = FullSize(photo, crop, size, align_corners=corners).frames(
        flow, torch.ones(2, 1, SIDE // 4, SIDE // 4), painted
    )
    assert frames.shape == (2, size, size, 3)
    wanted = cut_out(photo, crop, size)
    assert np.abs(frames.astype(int) - wanted).max() <= 1


def test_a_shift_by_whole_pixels_moves_whole_pixels(photo):
    crop = Crop(40, 10, 2 * SIDE)
    flow, occlusion, painted = at_rest()
    flow[..., 0] += 2 * 3 / (SIDE - 1)  # what lies 3 small pixels to the right
    frame = FullSize(photo, crop, crop.size).frames(flow, occlusion, painted)[0]
    assert np.array_equal(frame, cut_out(photo, Crop(46, 10, 2 * SIDE), crop.size))


def test_what_is_hidden_is_painted_in_the_same_colours(photo):
    flow, occlusion, painted = at_rest()
    painted[:] = torch.tensor([0.2, 0.4, 0.6])[None, :, None, None]
    make = FullSize(photo, Crop(40, 10, 100), 160)
    frame = make.frames(flow, occlusion * 0, painted)[0]
    assert np.abs(frame - [51, 102, 153]).max() <= 1
    half = make.frames(flow, occlusion * 0.5, painted)[0]
    wanted = 0.5 * cut_out(photo, Crop(40, 10, 100), 160) + [25.5, 51, 76.5]
    assert np.abs(half - wanted).max() <= 1


def test_at_the_networks_size_it_is_the_generators_frame():
    rng = np.random.default_rng(0)
    coarse = rng.integers(0, 256, (8, 8, 3), dtype=np.uint8)
    smooth = cv2.resize(coarse, (SIDE, SIDE), interpolation=cv2.INTER_CUBIC)
    source = from_pixels(torch.from_numpy(smooth)[None])
    field, occlusion, painted = wave()
    flow = Flow(field, occlusion, *[torch.zeros(1)] * 3)
    blended = LiteGenerator(32, 1).blend(source, painted, flow)
    wanted = to_pixels(blended)[0].numpy().astype(int)
    frame = FullSize(smooth, Crop(0, 0, SIDE), SIDE).frames(field, occlusion, painted)[0]
    inside = (field[0].abs() < 0.95).all(-1).numpy().repeat(4, 0).repeat(4, 1)
    assert inside.mean() > 0.6
    error = np.abs(frame - wanted)[inside].mean()
    assert error < 2  # bicubic against bilinear
    assert np.abs(smooth - wanted)[inside].mean() > 8 * error


def seam(frames, photo, crop):
    """Mean jump across the square's borders inside the photo: of the frames, of the photo."""
    jumps = []
    for image in (frames.astype(float), np.broadcast_to(photo, frames.shape).astype(float)):
        x, y, end = crop.x, crop.y, crop.y + crop.size
        rows, columns = slice(max(y, 0), end), slice(max(x, 0), x + crop.size)
        lines = [np.abs(image[:, end, columns] - image[:, end - 1, columns])]
        if y > 0:
            lines.append(np.abs(image[:, y, columns] - image[:, y - 1, columns]))
        if x > 0:
            lines.append(np.abs(image[:, rows, x] - image[:, rows, x - 1]))
        jumps.append(np.mean([line.mean() for line in lines]))
    return jumps


@pytest.mark.parametrize("crop", [Crop(30, 20, 90), Crop(-20, 20, 90)])
def test_in_the_whole_photo_no_border_is_seen(photo, crop):
    flow, occlusion, painted = wave(2)
    frames = FullSize(photo, crop, crop.size, whole=True).frames(flow, occlusion, painted)
    assert frames.shape == (2, *photo.shape)
    outside = np.ones(photo.shape[:2], bool)
    outside[max(crop.y, 0) : crop.y + crop.size, max(crop.x, 0) : crop.x + crop.size] = False
    assert np.array_equal(frames[:, outside], np.stack([photo[outside]] * 2))
    jump, own = seam(frames, photo, crop)
    assert jump <= own + 1e-6
    middle = (slice(None), slice(50, 80), slice(40, 60))
    assert np.abs(frames.astype(int) - photo)[middle].mean() > 3  # and yet it moves
    pasted = np.stack([photo] * 2)
    view = pasted[:, crop.y : crop.y + crop.size, max(crop.x, 0) : crop.x + crop.size]
    bare = FullSize(photo, crop, crop.size).frames(flow, occlusion, painted)
    view[:] = bare[:, :, max(-crop.x, 0) :]
    assert seam(pasted, photo, crop)[0] > 1.5 * own  # without the fade it would be


def test_motion_reaches_the_edges_of_the_photo(photo):
    """Where the square ends with the photo nothing fades."""
    flow, occlusion, painted = wave()
    crop = Crop(0, 0, 140)
    frame = FullSize(photo, crop, 140, whole=True).frames(flow, occlusion, painted)[0]
    alone = FullSize(photo, crop, 140).frames(flow, occlusion, painted)[0]
    assert np.array_equal(frame[:, :100], alone[:, :100])
    assert not np.array_equal(frame[:, :140], alone)


def test_the_whole_photo_keeps_its_size(photo):
    with pytest.raises(ValueError, match="90 pixels"):
        FullSize(photo, Crop(30, 20, 90), 128, whole=True)


def test_taps_by_hand():
    places, weights = taps(np.array([2.0, 2.5, -1.0, 9.0]), 5)
    assert places.tolist() == [[1, 2, 3, 4], [1, 2, 3, 4], [0, 0, 1, 2], [2, 3, 4, 4]]
    wanted = [[0, 1, 0, 0], [-1 / 16, 9 / 16, 9 / 16, -1 / 16], [0, 1, 0, 0], [0, 0, 1, 0]]
    np.testing.assert_allclose(weights, wanted, atol=1e-6)
    assert taps(np.array([0.0, 0.4]), 1)[0].tolist() == [[0, 0, 0, 0]] * 2


def test_fade_is_none_at_the_border_and_all_in_the_middle():
    both, one = border_fade(100, True, True), border_fade(100, False, True)
    assert both[0] == both[-1] == 0 and both[50] == 1 and (np.diff(both[:50]) >= 0).all()
    assert one[0] == 1 and one[-1] == 0 and np.array_equal(one[50:], both[50:])
    assert (border_fade(100, False, False) == 1).all()


@pytest.mark.parametrize("whole", [True, False])
def test_without_kernels_the_same_is_drawn(photo, whole):
    random = torch.Generator().manual_seed(2)
    crop = Crop(-10, 20, 90)
    flow = coordinate_grid(8, 8)[None] + 0.1 * torch.randn(1, 8, 8, 2, generator=random)
    occlusion, painted = torch.rand(1, 1, 8, 8, generator=random), torch.rand(1, 3, 32, 32)
    canvas = FullSize(photo, crop, 90, whole=whole)
    wanted = canvas.frames(flow, occlusion, painted).astype(int)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ANGIE_KERNELS", "0")
        found = canvas.frames(flow, occlusion, painted)
    assert np.abs(found - wanted).max() <= 1 and (found != wanted).mean() < 0.01
