"""Limbs as targets, joints of poses, and `angie teach` from its dataset to weights."""

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from angie.config import override, parse_overrides, preset
from angie.teaching import joints_of, marks_of_truth, teach_dataset
from data_prep.errors import BadInput
from data_prep.phantom.skeleton import JOINTS as DRAWN
from data_prep.speaker.people import Pose
from mraa.renderer import Renderer
from mraa.training.renderer import load_initial
from mraa.training.teach import (
    JOINTS,
    LIMBS,
    MarkedPairs,
    Teaching,
    limb_masks,
    limb_powers,
    region_targets,
)

SMALL = [
    "renderer.regions=20",
    *(f"renderer.{part}.{key}={n}" for part in ("estimator", "flow", "background")
      for key, n in (("width", 4), ("blocks", 3), ("max_width", 16))),
    "renderer.generator.width=16",
]  # fmt: skip


def small():
    return override(preset("tiny"), parse_overrides(SMALL))


def test_the_phantoms_joints_are_those_that_limbs_are_made_of():
    assert JOINTS == DRAWN and len(LIMBS) == 20


def test_a_limb_is_a_gaussian_along_its_joints():
    points = np.zeros((12, 2))
    points[JOINTS.index("right_elbow")], points[JOINTS.index("right_wrist")] = (
        (0.1, 0.2),
        (0.7, 0.2),
    )
    sure = np.ones(12)
    sure[JOINTS.index("right_wrist")] = 0.5
    unit = np.array([[1.0, 0, 0], [0, 1, 0]])
    forearm = LIMBS.index(("right_elbow", "right_wrist", 0.06))
    row = region_targets(points, sure, unit)[forearm]
    # centre; 1 / (0.6 / 3)^2 along and 1 / 0.06^2 across; the lesser of the two ends' worth
    assert row == pytest.approx([0.4, 0.2, 25, 0, 0, 1 / 0.0036, 0.5], abs=1e-4)


def test_masks_are_shares_and_arms_come_before_the_trunk():
    points = np.full((12, 2), 5.0)  # out of the picture
    for name in ("right_shoulder", "left_shoulder", "right_hand"):
        points[JOINTS.index(name)] = (0.0, 0.0)
    limbs = torch.from_numpy(region_targets(points, np.ones(12), np.eye(2, 3)))[None]
    masks = limb_masks(limbs, 33, 33)[0]
    torch.testing.assert_close(masks.sum(0), torch.ones(33, 33))
    middle = masks[:, 16, 16]
    hand, shoulders = (LIMBS.index(limb) + 1 for limb in (LIMBS[13], LIMBS[3]))
    assert middle[hand] > 100 * middle[shoulders]
    assert limb_powers(limbs, 33, 33)[0, 3, 16, 16] == 0  # the shoulders are there all the same
    limbs[..., 6] = 0  # nothing is believed: all is background
    assert (limb_masks(limbs, 33, 33)[0, 0] == 1).all()


def test_joints_follow_from_a_pose():
    points, visible = np.zeros((33, 2)), np.ones(33)
    points[[8, 7]], points[[10, 9]] = (100, 80), (100, 100)
    points[[12, 11]] = (60, 150), (140, 150)
    points[16], visible[16] = (50, 220), 0.1
    joints, sure = joints_of(Pose(points, visible, (np.zeros(2), 1.0, 0.0)), np.ones((2, 2)))
    found = dict(zip(JOINTS, joints.tolist(), strict=True))
    assert found["crown"][1] < 40 and 110 < found["chin"][1] < 125 < found["neck"][1] < 155
    assert found["right_shoulder"] == [60, 150] and found["left_shoulder"] == [140, 150]
    assert found["right_wrist"] == [50, 220] and found["left_hand"] == [1, 1]
    worth = dict(zip(JOINTS, sure, strict=True))
    assert worth["right_wrist"] == worth["right_hand"] == 0 and worth["left_wrist"] == 1


def test_pairs_have_the_limbs_where_the_frames_show_them(dataset, phantom_videos):
    pairs = MarkedPairs(dataset, marks_of_truth(dataset, phantom_videos))
    assert len(pairs) == len(dataset.clips("train"))
    frames, limbs = pairs.draw(0, np.random.default_rng(3))
    assert frames.shape == (2, 256, 256, 3) and frames.dtype == torch.uint8
    assert limbs.shape == (2, 20, 7) and (limbs[..., 6] == 1).all()
    again = pairs.draw(0, np.random.default_rng(3))
    assert torch.equal(frames, again[0]) and torch.equal(limbs, again[1])


def test_teaching_writes_weights_to_begin_with(dataset, phantom_videos, tmp_path):
    how, out = Teaching(2, 2, region_batch=2, mask_batch=2), tmp_path / "taught.safetensors"
    given = {"truth": phantom_videos, "how": how}
    count = teach_dataset(dataset.path, out, small(), **given)
    assert count == len(dataset.clips("train"))
    renderer = Renderer(small().renderer)
    fresh = {k: v.clone() for k, v in renderer.state_dict().items()}
    load_initial(renderer, out)
    assert not torch.equal(fresh["estimator.regions.weight"], renderer.estimator.regions.weight)
    half = Teaching(2, 1, region_batch=2, mask_batch=2)
    teach_dataset(dataset.path, tmp_path / "b.safetensors", small(), truth=phantom_videos, how=half)
    whole, part = load_file(out), load_file(tmp_path / "b.safetensors")
    same = [k for k in whole if torch.equal(whole[k], part[k])]
    assert all(k in same for k in whole if k.startswith(("estimator.regions", "generator.")))
    assert any(k not in same for k in whole if k.startswith("flow."))


def test_what_cannot_be_taught_is_told(dataset, phantom_videos, tmp_path):
    out = tmp_path / "out.safetensors"
    with pytest.raises(BadInput, match="20 regions are taught, not 10; set renderer.regions"):
        teach_dataset(dataset.path, out, preset("tiny"), truth=phantom_videos)
    with pytest.raises(BadInput, match="give --models"):
        teach_dataset(dataset.path, out, small())
    with pytest.raises(BadInput, match="holds the truth .* of no clip"):
        teach_dataset(dataset.path, out, small(), truth=tmp_path)
    with pytest.raises(BadInput, match="face_detection_short_range.tflite"):
        teach_dataset(dataset.path, out, small(), models=tmp_path)
    assert not any(tmp_path.iterdir())
