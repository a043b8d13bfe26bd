"""One training run: devices, precision, distribution, checkpoints, curves and progress.

Everything random in step i follows from (seed, i): which items are drawn, augmentation, dropout.
A run that is resumed from the checkpoint of step i is therefore the same run, bit for bit on one
CPU, and a checkpoint holds tensors and one number alone.

Endless batches of which every item follows from the seed and its place in the training alone.

Which process loads an item, and in which part of a step, changes nothing about the item: two
processes see in a step what one sees.
"""

import logging
import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.utils.data import DataLoader, Dataset, Sampler

from data_prep.errors import BadInput
from data_prep.progress import console, progress
from mraa.training.checkpoint import Scaler, checkpoint_identity, load_checkpoint, save_checkpoint
from mraa.training.curves import Curves
from mraa.training.devices import native_bf16, synchronise

if TYPE_CHECKING:
    from lightning_fabric import Fabric


SEED_STRIDE = 1_000_003
"""Keeps the seeds of neighbouring steps, items and runs apart."""


class StepSampler(Sampler[list[tuple[int, int]]]):
    """Endless batches of (index, seed); those of step i are a pure function of the seed and i.

    Args:
        length: items in an epoch.
        batch: items of a step, over all processes and parts.
        seed: of the run.
        first: step to begin with.
        rank: number of this process.
        world: number of processes.
        parts: batches that a step is computed in.

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


@dataclass(frozen=True)
class RunConfig:
    """How to run a training stage; not what it computes."""

    device: str = "auto"
    """"auto", "cpu", "cuda" or "mps"."""
    devices: int = 1
    """Processes on this machine; under torchrun its world size rules."""
    precision: str = "32-true"
    """Lightning Fabric's names: "32-true", "bf16-mixed", "16-mixed"; the command also knows
    "auto", see `native_precision`."""
    workers: int = 0
    """Processes that load data, each; and that measure the motion of clips on a CPU."""
    checkpoint_seconds: float = 120.0
    """Longest work that a kill can lose."""
    log_every: int = 10
    """Steps between points of the curves."""
    identity: str = ""
    """What a stage is trained on; a checkpoint of something else is not resumed."""


def native_precision(device: str = "auto") -> str:
    """Name "bf16-mixed" where the device computes in bfloat16 natively, else "32-true"."""
    cuda = device != "cpu" and torch.cuda.is_available()
    return "bf16-mixed" if native_bf16(torch.device("cuda" if cuda else "cpu")) else "32-true"


def launch(config: RunConfig, *, resting: bool = False) -> "Fabric":
    """Start (or join) the processes that a configuration asks for.

    Args:
        config: device, processes, precision.
        resting: some parameters of the model may be left without gradients.

    Raises:
        BadInput: a device or precision that this machine does not have.
    """
    # takes two seconds, and whoever wants a number of `RunConfig` imports this module
    from lightning_fabric import Fabric
    from lightning_fabric.strategies import DDPStrategy
    from lightning_fabric.utilities.exceptions import MisconfigurationException

    logging.getLogger("lightning_fabric").setLevel(logging.WARNING)  # no line for each launch
    devices = int(os.environ.get("LOCAL_WORLD_SIZE", config.devices))  # torchrun's word counts
    nodes = int(os.environ.get("GROUP_WORLD_SIZE", "1"))
    try:
        fabric = Fabric(
            accelerator=config.device,
            devices=devices,
            num_nodes=nodes,
            precision=config.precision,  # type: ignore[arg-type]
            strategy=DDPStrategy(find_unused_parameters=resting) if devices * nodes > 1 else "auto",
        )
        fabric.launch()
    except (ValueError, RuntimeError, MisconfigurationException) as error:
        reason = str(error).splitlines()[0]
        raise BadInput(f"--device, --devices or --precision: {reason}") from error
    return fabric


class Run:
    """A stage of training.

    A stage is a flat loop::

        run = Run(folder, "vq", steps=1000, seed=0)
        model, optimizer = run.setup(model, optimizer)
        batches = run.batches(windows, batch_size=32)
        for step in run.steps():
            loss = model(next(batches))
            run.backward(loss)
            optimizer.step()
            optimizer.zero_grad()
            run.log(loss=loss)

    Args:
        folder: checkpoints go to `folder/<stage>.safetensors`, curves to `folder/curves/<stage>`.
        stage: name of the stage.
        steps: number of optimiser steps.
        seed: everything random follows from it.
        config: device, precision and so on.
        resume: go on from the checkpoint if there is one; else start anew.
        resting: some parameters are not trained in this stage.
    """

    def __init__(
        self,
        folder: Path,
        stage: str,
        *,
        steps: int,
        seed: int = 0,
        config: RunConfig | None = None,
        resume: bool = False,
        resting: bool = False,
    ) -> None:
        self.config = config or RunConfig()
        self.folder, self.stage, self.total, self.seed = Path(folder), stage, steps, seed
        self.fabric = launch(self.config, resting=resting)
        self.resume = resume
        self.first = 0
        self.step = 0
        self._note = ""
        self._models: list[nn.Module] = []
        self._optimizer: torch.optim.Optimizer | None = None
        self._curves: Curves | None = None
        self._logged: dict[str, list[Tensor]] = {}
        torch.manual_seed(seed)

    @property
    def checkpoint(self) -> Path:
        """Where this stage's checkpoint lies."""
        return self.folder / f"{self.stage}.safetensors"

    @property
    def device(self) -> torch.device:
        """Where the stage computes."""
        return self.fabric.device

    def setup(
        self, model: nn.Module, optimizer: torch.optim.Optimizer
    ) -> tuple[Any, torch.optim.Optimizer]:
        """Place model and optimiser, and restore both when resuming."""
        self._models, self._optimizer = [model], optimizer
        if self.fabric.world_size > 1 and _cuda(self):
            model = nn.SyncBatchNorm.convert_sync_batchnorm(model)
        elif self.fabric.world_size > 1:
            synchronise(model)
        wrapped, placed = self.fabric.setup(model, optimizer)
        self._models, self._optimizer = [wrapped.module], placed
        if self.resume and self.checkpoint.exists():
            self.first = self.step = self._restore(wrapped.module, placed)
        elif self.fabric.global_rank == 0:
            self.checkpoint.unlink(missing_ok=True)  # of an earlier training
        self.fabric.barrier()
        return wrapped, placed

    def _restore(self, model: nn.Module, optimizer: torch.optim.Optimizer) -> int:
        """Steps of the checkpoint, or 0 if it was trained on something else."""
        if checkpoint_identity(self.checkpoint) != self.config.identity:
            console.print(f"{self.stage}: the checkpoint was trained on something else; anew")
            return 0
        return load_checkpoint(self.checkpoint, model, optimizer, self._scaler)

    @property
    def scaled(self) -> bool:
        """Whether losses are scaled, as in 16-bit training alone."""
        return self._scaler is not None

    @property
    def _scaler(self) -> Scaler | None:
        """The loss scale; 16-bit training alone has one."""
        return getattr(self.fabric.strategy.precision, "scaler", None)

    def batches(self, items: Any, batch_size: int, parts: int = 1) -> Iterator[Any]:
        """Endless batches from the step at which this run begins.

        Args:
            items: has `len` and either `items[index]` or `items.draw(index, generator)` with a
                NumPy generator for what is random in an item.
            batch_size: of a step, over all processes and parts together.
            parts: batches that a step is computed in.
        """
        sampler = StepSampler(
            len(items),
            batch_size,
            self.seed,
            self.first,
            self.fabric.global_rank,
            self.fabric.world_size,
            parts,
        )
        loader: DataLoader[Any] = DataLoader(
            SeededItems(items),
            batch_sampler=sampler,
            num_workers=self.config.workers,
            pin_memory=_cuda(self),
            persistent_workers=self.config.workers > 0,
            generator=torch.Generator().manual_seed(self.seed),  # leaves the step's own alone
        )
        for batch in loader:
            yield self.fabric.to_device(batch)

    def steps(self) -> Iterator[int]:
        """Steps that remain; seeds torch at each, shows progress, writes checkpoints."""
        self.folder.mkdir(parents=True, exist_ok=True)
        saved = time.monotonic()
        try:
            with progress(self.stage, self.total, "steps", self.first) as advance:
                for step in range(self.first, self.total):
                    self.step = step
                    torch.manual_seed(
                        (self.seed * SEED_STRIDE + step) * 64 + self.fabric.global_rank
                    )
                    yield step
                    self._flush()
                    advance(1, self._note)
                    self.step = step + 1
                    if time.monotonic() - saved > self.config.checkpoint_seconds:
                        self.save()
                        saved = time.monotonic()
            self.save()
            self.fabric.barrier()
        finally:
            if self._curves is not None:
                self._curves.close()

    def parts(self, model: Any, count: int) -> Iterator[int]:
        """Parts of a step whose gradients add up: processes exchange them in the last one.

        Args:
            model: as `setup` returned it.
            count: of parts; every loss has to be divided by it.
        """
        for part in range(count):
            with self.fabric.no_backward_sync(model, enabled=part + 1 < count):
                yield part

    def backward(self, loss: Tensor) -> None:
        """Gradients of a scalar loss, scaled and averaged as precision and devices ask."""
        self.fabric.backward(loss)

    def clip(self, model: nn.Module, optimizer: torch.optim.Optimizer, norm: float) -> None:
        """Scale the gradients to at most `norm`."""
        self.fabric.clip_gradients(model, optimizer, max_norm=norm, error_if_nonfinite=False)

    def rate(
        self,
        optimizer: torch.optim.Optimizer,
        base: float,
        milestones: Sequence[int] = (),
        factor: float = 0.1,
    ) -> None:
        """Set the learning rate of this step: `base * factor^(milestones passed)`."""
        passed = sum(self.step >= milestone for milestone in milestones)
        for group in optimizer.param_groups:
            group["lr"] = base * factor**passed

    def log(self, **scalars: Tensor | float) -> None:
        """Add points to the curves, every `log_every` steps, and show them.

        The mean over processes counts, and over several calls in a step. Every process has to
        give the same names.
        """
        if self.step % self.config.log_every == 0 or self.step + 1 == self.total:
            for name, value in scalars.items():
                number = torch.as_tensor(value, dtype=torch.float32, device=self.device)
                self._logged.setdefault(name, []).append(number.detach())

    def _flush(self) -> None:
        if not self._logged:
            return
        means = torch.stack([torch.stack(values).mean() for values in self._logged.values()])
        means = self.fabric.all_reduce(means, reduce_op="mean")  # type: ignore[assignment]
        values = dict(zip(self._logged, means.tolist(), strict=True))
        self._logged.clear()
        self._note = "  ".join(f"{name} {value:.4g}" for name, value in values.items())
        if self.fabric.global_rank == 0:
            self.curves.add(self.step, values)

    @property
    def curves(self) -> Curves:
        """Curves of this stage; the first process alone writes them."""
        if self._curves is None:
            self._curves = Curves(self.folder / "curves", self.stage, self.first)
        return self._curves

    def save(self) -> None:
        """Write the checkpoint of the steps done so far; whole or not at all.

        The first process alone decides when and writes; the others wait for it in their next
        step, not here, because their clocks differ.
        """
        if self.fabric.global_rank == 0 and self._optimizer is not None:
            save_checkpoint(
                self.checkpoint,
                self._models[0],
                self._optimizer,
                self.step,
                self.config.identity,
                self._scaler,
            )
            if self._curves is not None:
                self._curves.write()


def _cuda(run: Run) -> bool:
    return run.fabric.device.type == "cuda"
