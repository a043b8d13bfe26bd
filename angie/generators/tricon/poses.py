"""Poses as TriCon sees them: directions of bones, or offsets along a tree of regions.

The paper's numbers are unit direction vectors, which free joints from root motion and the length of
bones. In a picture regions have neither: what takes the place of a bone is the offset of a region
from its parent in a tree, not brought to unit length, because projection changes lengths.
"""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree
from torch import Tensor, nn
from torch.nn.functional import normalize

KINDS = ("auto", "tree", "displacement", "directions")

SIZE = 0.2
"""Deviation of standardised numbers: about that of unit vectors, for which losses are weighted."""


def spanning_tree(points: NDArray, root: int) -> list[int]:
    """Parent of each point (K, C) in the minimum spanning tree, -1 for the root.

    Args:
        points: mean positions.
        root: place of the point that has no parent.
    """
    apart = np.linalg.norm(points[:, None] - points, axis=-1) + 1e-9  # 0 would be no edge
    tree = minimum_spanning_tree(np.triu(apart, 1))
    _, parents = breadth_first_order(tree, root, directed=False)
    return [-1 if i == root else int(parent) for i, parent in enumerate(parents)]


def ancestors(parents: Sequence[int]) -> Tensor:
    """Matrix (K, K) that sums offsets up along a tree: 1 where j is i or above it.

    Raises:
        ValueError: not one root, or a circle.
    """
    count = len(parents)
    if sum(parent < 0 for parent in parents) != 1 or max(parents) >= count:
        raise ValueError("bones: one point has no parent (-1), the others have one of the points")
    sums = torch.zeros(count, count)
    for point in range(count):
        above = point
        for _ in range(count):
            if above < 0:
                break
            sums[point, above] = 1
            above = parents[above]
        if above >= 0:
            raise ValueError("bones: go in a circle")
    return sums


class Poses(nn.Module):
    """Motion vectors as poses of about equal size, and back.

    Kinds: "tree" (K regions: the root's displacement and offsets from parents, 2K; displacements of
    the Cholesky factors, 3K), "displacement" (from the rest pose, as it is), "directions" (points:
    unit vectors from parent to child, (K - 1) C numbers).

    Attributes:
        parents: (K,) int64, -1 for the root.
        sums: (K, K) see `ancestors`.
        mean: (D,) of training.
        scale: (D,) what poses are divided by, 1 for directions.
    """

    def __init__(self, points: int, extent: bool, kind: str, axes: int = 2) -> None:
        super().__init__()
        if kind not in KINDS or (extent and kind == "directions"):
            raise ValueError(f"pose is one of {', '.join(KINDS)}; directions are of points")
        if kind == "auto":
            kind = "tree" if extent else "directions"
        self.points, self.kind, self.axes = points, kind, axes
        self.position = axes * points
        size = self.position + (3 * points if extent else 0)
        self.size = axes * (points - 1) if kind == "directions" else size
        self.register_buffer("parents", torch.zeros(points, dtype=torch.int64))
        self.register_buffer("sums", torch.eye(points))
        self.register_buffer("mean", torch.zeros(self.size))
        self.register_buffer("scale", torch.ones(self.size))
        self.parents: Tensor
        self.sums: Tensor
        self.mean: Tensor
        self.scale: Tensor

    def fit(self, motions: Sequence[Tensor], rests: Sequence[Tensor], bones: Sequence[int]) -> None:
        """Find tree, mean and scale of training motion.

        Args:
            motions: vectors (T, C) of each clip.
            rests: (C,) rest pose of each clip's speaker.
            bones: parents of the points; none is the minimum spanning tree of their mean places,
                from the point that moves least.

        Raises:
            ValueError: bones that are no tree of the points.
        """
        if bones:
            if len(bones) != self.points:
                raise ValueError(f"bones: {len(bones)} parents of {self.points} points")
            parents = list(bones)
        else:
            place = [motion[:, : self.position].unflatten(1, (-1, self.axes)) for motion in motions]
            moved = torch.cat([points.diff(dim=0) for points in place]).norm(dim=-1).mean(0)
            middle = torch.cat(place).mean(0).double().numpy()
            parents = spanning_tree(middle, int(moved.argmin()))
        self.sums.copy_(ancestors(parents))
        self.parents.copy_(torch.tensor(parents))
        raw = torch.cat([self._raw(m, r) for m, r in zip(motions, rests, strict=True)])
        self.mean.copy_(raw.mean(0))
        if self.kind != "directions":
            self.scale.copy_(raw.std(0).clamp_min(1e-4) / SIZE)

    def _raw(self, vector: Tensor, rest: Tensor) -> Tensor:
        """Poses (..., D) before they are standardised."""
        if self.kind == "displacement":
            return vector - rest
        if self.kind == "tree":
            vector = vector - rest
        place = vector[..., : self.position].unflatten(-1, (-1, self.axes))
        child = self.parents >= 0
        above = place[..., self.parents.clamp_min(0), :] * child[:, None]
        if self.kind == "directions":
            return normalize((place - above)[..., child, :], dim=-1, eps=1e-6).flatten(-2)
        return torch.cat([(place - above).flatten(-2), vector[..., self.position :]], dim=-1)

    def encode(self, vector: Tensor, rest: Tensor) -> Tensor:
        """Poses (..., D) of motion vectors (..., C) of a person with this rest pose (C,)."""
        return (self._raw(vector, rest) - self.mean) / self.scale

    def decode(self, pose: Tensor, rest: Tensor, start: Tensor) -> Tensor:
        """Motion vectors (..., C) of poses (..., D).

        Args:
            pose: standardised.
            rest: (C,) rest pose.
            start: (C,) pose whose root and bone lengths directions are drawn with.
        """
        raw = pose * self.scale + self.mean
        if self.kind == "displacement":
            return rest + raw
        if self.kind == "tree":
            offsets = raw[..., : self.position].unflatten(-1, (-1, self.axes))
            place = (self.sums @ offsets).flatten(-2)
            return rest + torch.cat([place, raw[..., self.position :]], dim=-1)
        place = start[: self.position].unflatten(-1, (-1, self.axes))
        child = self.parents >= 0
        lengths = (place - place[self.parents.clamp_min(0)])[child].norm(dim=-1, keepdim=True)
        bones = normalize(raw.unflatten(-1, (-1, self.axes)), dim=-1, eps=1e-6) * lengths
        offsets = pose.new_zeros(*pose.shape[:-1], self.points, self.axes)
        offsets[..., child, :] = bones
        offsets[..., ~child, :] = place[~child]
        return (self.sums @ offsets).flatten(-2)
