"""Poses along a tree of regions, and directions of bones."""

import numpy as np
import pytest
import torch

from angie.generators.tricon.poses import SIZE, Poses, ancestors, spanning_tree


def test_the_tree_joins_neighbours():
    line = np.array([[0.0, 0], [1, 0], [2, 0], [2, 1]])
    assert spanning_tree(line, 1) == [1, -1, 1, 2]
    assert spanning_tree(line, 3) == [1, 2, 3, -1]


def test_offsets_are_summed_up_along_it():
    rows = [[1, 1, 0, 0], [0, 1, 0, 0], [0, 1, 1, 0], [0, 1, 1, 1]]
    assert ancestors([1, -1, 1, 2]).tolist() == rows


@pytest.mark.parametrize("parents", [[-1, -1, 0], [1, 0, -1], [0, 1, 2], [-1, 0, 3]])
def test_bones_that_are_no_tree(parents):
    with pytest.raises(ValueError, match="bones"):
        ancestors(parents)


def fitted(kind="auto", extent=True, axes=2, points=4):
    torch.manual_seed(0)
    size = points * (axes + (3 if extent else 0))
    motion = torch.randn(50, size) * torch.linspace(0.1, 2, size) + torch.arange(size)
    poses = Poses(points, extent, kind, axes)
    poses.fit([motion], [motion.mean(0)], ())
    return poses, motion


@pytest.mark.parametrize("kind", ["auto", "displacement"])
def test_regions_go_there_and_back(kind):
    poses, motion = fitted(kind)
    made = poses.encode(motion, motion.mean(0))
    assert poses.size == 20 and torch.allclose(made.std(0), torch.full((20,), SIZE), rtol=1e-4)
    assert torch.allclose(made.mean(0), torch.zeros(20), atol=1e-5)
    back = poses.decode(made, motion.mean(0), motion[0])
    assert torch.allclose(back, motion, atol=1e-4)


def test_a_parent_takes_its_children_along():
    poses = Poses(3, True, "tree")
    poses.parents.copy_(torch.tensor([-1, 0, 1]))
    poses.sums.copy_(ancestors([-1, 0, 1]))
    rest = torch.arange(15.0)
    moved = rest.clone()
    moved[:6] += torch.tensor([1.0, 0, 1, 0, 1, 0])  # all to the right by 1
    assert poses.encode(moved, rest)[:6].tolist() == [1, 0, 0, 0, 0, 0]
    pose = torch.zeros(15)
    pose[2] = 0.5  # the second alone, and what hangs on it
    change = poses.decode(pose, rest, rest) - rest
    assert change[:6].tolist() == [0, 0, 0.5, 0, 0.5, 0]


@pytest.mark.parametrize("axes", [2, 3])
def test_directions_keep_the_lengths_of_the_start_pose(axes):
    poses, motion = fitted("auto", extent=False, axes=axes)
    assert poses.kind == "directions" and poses.size == 3 * axes
    back = poses.decode(poses.encode(motion, motion[0]), motion[0], motion[7])
    made, true = (x.unflatten(1, (4, axes)) for x in (back, motion))
    child = (poses.parents >= 0).nonzero()[:, 0]
    bone = made[:, child] - made[:, poses.parents[child]]
    own = true[:, child] - true[:, poses.parents[child]]
    assert torch.allclose(bone.norm(dim=-1), own[7].norm(dim=-1).expand(50, -1), rtol=1e-3)
    alike = torch.cosine_similarity(bone, own, dim=-1)
    assert torch.allclose(alike, torch.ones_like(alike), atol=1e-4)
    root = int((poses.parents < 0).nonzero())
    assert torch.allclose(made[:, root], true[7, root].expand(50, -1))


def test_given_bones():
    poses, motion = fitted("auto", extent=False)
    poses.fit([motion], [motion[0]], (-1, 0, 0, 0))
    assert poses.parents.tolist() == [-1, 0, 0, 0]
    with pytest.raises(ValueError, match="3 parents of 4 points"):
        poses.fit([motion], [motion[0]], (-1, 0, 0))
    with pytest.raises(ValueError, match="pose is one of"):
        Poses(4, True, "directions")
