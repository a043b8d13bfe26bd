"""Endless batches of which every item follows from the seed and its place in the training alone.

Which process loads an item, and in which part of a step, changes nothing about the item: two
processes see in a step what one sees.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from torch.utils.data import Dataset, Sampler

from data_prep.errors import BadInput

SEED_STRIDE = 1_000_003
"""Keeps the seeds of neighbouring steps, items and runs apart."""


class StepSampler(Sampler[list[tuple[int, int]]]):
    """Endless batches of (index, seed); those of step i are a pure function of the seed and i.

    `length`: items in an epoch. `batch`: items of a step, over all processes and parts. `parts`:
    batches that a step is computed in.

    Raises:
        BadInput: a step's items do not divide evenly.
    """

    def __init__(
        self, length: int, batch: int, seed: int, first: int, rank: int, world: int, parts: int = 1
    ) -> None:
        if batch % (world * parts):
            raise BadInput(f"batch {batch} does not divide over {world} processes x {parts} parts")
        self.length, self.batch, self.seed = length, batch, seed
        self.first, self.rank, self.world, self.parts = first, rank, world, parts
        self._epoch, self._order = -1, np.arange(0)

    def __iter__(self) -> Iterator[list[tuple[int, int]]]:
        size = self.batch // self.parts
        start = self.first * self.batch
        while True:
            yield [self._item(start + offset) for offset in range(self.rank, size, self.world)]
            start += size

    def _item(self, position: int) -> tuple[int, int]:
        """Every epoch is one permutation of all items."""
        epoch, place = divmod(position, self.length)
        if self._epoch != epoch:
            order = np.random.default_rng([self.seed, epoch]).permutation(self.length)
            self._epoch, self._order = epoch, order
        return int(self._order[place]), self.seed * SEED_STRIDE + position


class SeededItems(Dataset[Any]):
    """Gives every item its own random generator, drawn from (seed, position)."""

    def __init__(self, items: Any) -> None:
        self.items = items

    def __getitem__(self, key: tuple[int, int]) -> Any:
        index, seed = key
        if hasattr(self.items, "draw"):
            return self.items.draw(index, np.random.default_rng(seed))
        return self.items[index]
