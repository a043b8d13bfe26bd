"""One training run: models, optimisers, checkpoints, curves and progress.

Everything random in step i follows from (seed, i): which items are drawn, augmentation, dropout.
A run that is resumed from the checkpoint of step i is therefore the same run, bit for bit on one
CPU, and a checkpoint holds tensors and a few numbers alone.
"""

import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.utils.data import DataLoader

from data_prep.progress import console, progress
from mraa.training.batches import SEED_STRIDE, SeededItems, StepSampler
from mraa.training.checkpoint import Best, Checkpoint, Scaler, save_checkpoint
from mraa.training.curves import Curves
from mraa.training.devices import RunConfig as RunConfig
from mraa.training.devices import launch, synchronise
from mraa.training.devices import native_precision as native_precision


class Run:
    """A stage of training: its models, optimisers, checkpoint, curves and progress.

    A stage is a flat loop::

        run = Run(folder, "net", steps=1000, seed=0)
        model = run.add("net", net, torch.optim.Adam(net.parameters(), lr=3e-4), milestones=[800])
        batches = run.batches(windows, batch_size=32)
        for step in run.steps():
            loss = model(next(batches))
            run.update(loss, "net", clip=1.0)
            if run.due(checks=20):
                run.keep_best(held_out_loss(net), patience=5)
            run.log(loss=loss)
        run.restore_best()

    Args:
        folder: checkpoints go to `folder/<stage>.safetensors`, curves to `folder/curves/<stage>`.
        stage: name of the stage.
        steps: number of optimiser steps.
        seed: everything random follows from it.
        config: device, precision and so on.
        resume: go on from the checkpoint if there is one; else start anew.
        unused_parameters: some parameters are not trained in this stage.

    Raises:
        BadInput: the checkpoint to go on from is damaged or of another version, or the machine
            does not have what `config` asks for.
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
        unused_parameters: bool = False,
    ) -> None:
        self.config = config or RunConfig()
        self.folder, self.stage, self.total, self.seed = Path(folder), stage, steps, seed
        self.fabric = launch(self.config, unused_parameters=unused_parameters)
        self.models: dict[str, nn.Module] = {}
        self.optimizers: dict[str, torch.optim.Optimizer] = {}
        self._wrapped: dict[str, Any] = {}
        self._rates: dict[str, tuple[list[float], tuple[int, ...]]] = {}
        self._part, self._parts = 0, 1
        self._note = ""
        self._curves: Curves | None = None
        self._logged: dict[str, list[Tensor]] = {}
        self._saved = self._open() if resume and self.checkpoint.exists() else None
        if self._saved is None and self.fabric.global_rank == 0:
            self.checkpoint.unlink(missing_ok=True)  # of an earlier training
        self.fabric.barrier()
        self.first = self.step = 0 if self._saved is None else self._saved.step
        self.best = Best() if self._saved is None else self._saved.best
        torch.manual_seed(seed)

    @property
    def checkpoint(self) -> Path:
        """Where this stage's checkpoint lies."""
        return self.folder / f"{self.stage}.safetensors"

    @property
    def device(self) -> torch.device:
        """Where the stage computes."""
        return self.fabric.device

    def _open(self) -> Checkpoint | None:
        """The checkpoint, unless it was trained on something else."""
        saved = Checkpoint(self.checkpoint)
        if saved.identity == self.config.identity:
            return saved
        console.print(f"{self.stage}: the checkpoint was trained on something else; anew")
        return None

    def add(
        self,
        name: str,
        model: nn.Module,
        optimizer: torch.optim.Optimizer | None = None,
        milestones: Sequence[int] = (),
    ) -> Any:
        """Place a model and its optimiser on the device, and restore both when resuming.

        Args:
            name: of both in the checkpoint, without a dot.
            model: put in training mode; without an optimiser, a target network or an averaged
                model, in evaluation mode and without gradients.
            optimizer: of the model's parameters.
            milestones: steps at which the learning rate falls to a tenth.

        Returns:
            The model to call in the loop; `model` itself stays the plain module. With several
            processes, what a loss of another model passes through is called as `plain.forward`.

        Raises:
            BadInput: the checkpoint holds another architecture.
        """
        if "." in name or name in self.models:
            raise ValueError(f"{name}: names of models are different and have no dot")
        placed: Any = model
        if optimizer is None:
            model.to(self.device).eval().requires_grad_(False)
        else:
            if self.fabric.world_size > 1 and _cuda(self):
                model = nn.SyncBatchNorm.convert_sync_batchnorm(model)
            elif self.fabric.world_size > 1:
                synchronise(model)
            placed, self.optimizers[name] = self.fabric.setup(model.train(), optimizer)
            model = placed.module
            rates = [group["lr"] for group in optimizer.param_groups]
            self._rates[name] = rates, tuple(milestones)
        self.models[name], self._wrapped[name] = model, placed
        if self._saved is not None:
            self._saved.restore(name, model, self.optimizers.get(name))
        return placed

    def _begin(self) -> None:
        """What can be restored only when every model is there."""
        if self._saved is not None:
            if self._saved.names != set(self.models):
                raise self._saved.unlike()
            if self._scaler is not None:
                self._saved.restore_scale(self._scaler)
        self._saved = None

    @property
    def scaled(self) -> bool:
        """Whether losses are scaled, as in 16-bit training only."""
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
        """Steps that remain, until the best score is out of patience.

        Seeds torch and sets the learning rates at each, shows progress, writes checkpoints.

        Raises:
            BadInput: the checkpoint holds other models.
        """
        self._begin()
        self.folder.mkdir(parents=True, exist_ok=True)
        saved = time.monotonic()
        try:
            with progress(self.stage, self.total, "steps", self.first) as advance:
                for step in range(self.first, self.total):
                    if self.best.exhausted:
                        break
                    self.step = step
                    torch.manual_seed(
                        (self.seed * SEED_STRIDE + step) * 64 + self.fabric.global_rank
                    )
                    self._set_rates()
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

    def _set_rates(self) -> None:
        for name, (rates, milestones) in self._rates.items():
            passed = sum(self.step >= milestone for milestone in milestones)
            for group, rate in zip(self.optimizers[name].param_groups, rates, strict=True):
                group["lr"] = rate * 0.1**passed

    def parts(self, count: int, *names: str) -> Iterator[int]:
        """Parts of a step whose gradients add up; `update` steps in the last one.

        Args:
            count: of parts.
            names: of the models that are updated, whose processes exchange gradients at the end.
        """
        try:
            for self._part in range(count):
                self._parts = count
                with ExitStack() as stack:
                    for name in names:
                        wrapped, last = self._wrapped[name], self._part + 1 == count
                        stack.enter_context(self.fabric.no_backward_sync(wrapped, enabled=not last))
                    yield self._part
        finally:
            self._part, self._parts = 0, 1

    def update(self, loss: Tensor, *names: str, clip: float | None = None) -> None:
        """Gradients of a loss, and one step of the optimisers of the models named.

        Only these models get gradients, whatever else the loss passes through.

        Args:
            loss: scalar; in `parts` the mean over them counts.
            names: of models that have an optimiser.
            clip: largest norm of each model's gradients.
        """
        learning = [p for name in names for p in self.models[name].parameters() if p.requires_grad]
        self.fabric.backward(loss / self._parts if self._parts > 1 else loss, inputs=learning)
        if self._part + 1 < self._parts:
            return
        scaler: Any = self._scaler
        for name in names:
            optimizer: Any = self.optimizers[name]
            if clip is not None:
                self.fabric.clip_gradients(
                    self._wrapped[name], optimizer, max_norm=clip, error_if_nonfinite=False
                )
            if scaler is None:
                optimizer.step()
            else:  # Fabric would change the scale after each optimiser
                scaler.step(optimizer.optimizer)
        if scaler is not None:
            scaler.update()
        for name in names:
            self.optimizers[name].zero_grad()

    def due(self, checks: int) -> bool:
        """Whether one of `checks` evenly spaced evaluations belongs to this step."""
        return (self.step + 1) % max(1, self.total // checks) == 0

    def keep_best(self, score: float, patience: int = 0, *names: str) -> None:
        """Keep the present weights if their score is lower than all before.

        Latest and lowest score appear in the curves.

        Args:
            score: lower is better; that of the first process counts.
            patience: evaluations without improvement after which `steps` ends; 0 for never.
            names: of the models to keep; none for all that have an optimiser.
        """
        self.best.patience = patience
        kept = {name: self.models[name] for name in names or self.optimizers}
        self.best.consider(float(self.fabric.broadcast(score)), kept)

    def restore_best(self) -> None:
        """Put the best weights into the models; without any score they are left as they are."""
        for name, weights in self.best.weights.items():
            self.models[name].load_state_dict(weights)

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
        if self.best.weights:
            values |= {"held_out": self.best.latest, "best": self.best.score}
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
        if self.fabric.global_rank == 0:
            save_checkpoint(
                self.checkpoint,
                self.models,
                self.optimizers,
                self.step,
                self.config.identity,
                self._scaler,
                self.best,
            )
            if self._curves is not None:
                self._curves.write()


def _cuda(run: Run) -> bool:
    return run.fabric.device.type == "cuda"
