import shutil

import av
import numpy as np
import pytest
import torch
from PIL import Image

from angie.bundle import BUNDLE, PHOTO, Bundle
from angie.generators.angie.code_sheet import choose_pairs, code_sheet, pair_motion
from data_prep.errors import BadInput
from mraa.motion import Motion


@pytest.fixture(scope="module")
def shipped() -> Bundle:
    return Bundle.open(BUNDLE)


def test_a_pair_moves_from_the_pose_it_is_given(shipped):
    generator = shipped.generator()
    rest = Motion.from_vector(generator.statistics.rest[:1])
    still = pair_motion(generator, generator.vq.start_codes(), rest)
    pairs = choose_pairs(generator, [], 3)
    assert len(pairs) == 3 and len({int(pair.codes[0]) for pair in pairs}) == 3
    motions = [pair_motion(generator, pair.codes, rest) for pair in pairs]
    moving = max(motions, key=lambda motion: float((motion.shift - rest.shift).abs().mean()))
    assert moving.shift.shape == (16, 20, 2)
    assert (moving.shift[0] - rest.shift[0]).abs().max() < 0.2  # begins there
    moved = [(m.shift - rest.shift).norm(dim=-1).mean() for m in (still, moving)]
    assert moved[1] > 3 * moved[0]
    other = Motion(rest.shift + 0.1, rest.cholesky)  # the same code moves another pose alike
    again = pair_motion(generator, pairs[0].codes, other)
    assert torch.allclose(again.shift - 0.1, motions[0].shift, atol=1e-5)


def test_frequent_pairs_come_from_the_report(shipped):
    generator = shipped.generator()
    still = generator.vq.start_codes().tolist()
    rest = Motion.from_vector(generator.statistics.rest[:1])

    def amount(codes):
        motion = pair_motion(generator, torch.tensor(codes), rest)
        return float((motion.shift - rest.shift).norm(dim=-1).mean())

    pairs = [pair.codes.tolist() for pair in choose_pairs(generator, [], 6)]
    movers = sorted(pairs, key=amount, reverse=True)
    report = [[*still, 99], [*movers[0], 9], [movers[0][0], 7, 8], [*movers[1], 7]]
    chosen = choose_pairs(generator, report, 4)
    assert [int(pair.codes[0]) for pair in chosen] == [movers[0][0], movers[1][0]]
    assert chosen[0].count == 9 and "9 times" in str(chosen[0])


def test_a_sheet_and_a_film(shipped, tmp_path):
    sheet = code_sheet(shipped, [PHOTO], tmp_path / "sheet.png", count=1)
    picture = np.asarray(Image.open(sheet.picture))
    assert picture.shape == (256 + 22 + 2 * 120, 400, 3)
    with av.open(str(sheet.video)) as film:
        frames = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
    assert frames[0].shape == (278, 256, 3) and len(frames) == 88
    differences = [np.abs(frame.astype(int) - frames[0]).mean() for frame in frames]
    assert differences[3] < 0.5 * differences[22] and differences[43] < 0.8 * differences[22]


def test_bad_requests_leave_nothing_behind(shipped, tmp_path):
    with pytest.raises(BadInput, match="must end in .png"):
        code_sheet(shipped, [PHOTO], tmp_path / "sheet.jpg")
    (tmp_path / "sheet.mp4").touch()
    with pytest.raises(BadInput, match="sheet.mp4"):
        code_sheet(shipped, [PHOTO], tmp_path / "sheet.png")
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(BadInput, match=r"folder\.png: is a folder"):
        code_sheet(shipped, [tmp_path / "none.png"], tmp_path / "folder.png", force=True)
    (tmp_path / "folder.png").rmdir()
    copy = tmp_path / "copy.png"
    shutil.copy(PHOTO, copy)
    with pytest.raises(BadInput, match="copy.png"):
        code_sheet(shipped, [copy], copy, force=True)
    wall = tmp_path / "wall.png"
    Image.new("RGB", (320, 240), "grey").save(wall)
    with pytest.raises(BadInput, match=r"wall\.png: no face found; take a photo that shows one$"):
        code_sheet(shipped, [wall], tmp_path / "other.png")
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["copy.png", "sheet.mp4", "wall.png"]
