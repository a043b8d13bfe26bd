"""Checkpoints of training: tensors and a few words in one safetensors file, nothing pickled.

How long a motion stage trains, at what rate, and when its best weights were.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import torch
from safetensors import SafetensorError
from torch import Tensor, nn

from data_prep.errors import BadInput
from data_prep.files import whole_file
from data_prep.tensors import open_tensors, save_tensors

FORMAT = "2"
"""Several named models and optimisers; before, a file held one of each."""


class Scaler(Protocol):
    """The loss scale of 16-bit training, `torch.amp.GradScaler`."""

    def state_dict(self) -> dict[str, Any]:
        """Plain numbers."""

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Take over what `state_dict` gave."""


@dataclass
class Best:
    """The lowest score of a run so far and the weights that had it.

    Attributes:
        score: the lowest.
        latest: the score of the last evaluation.
        age: evaluations since the lowest.
        patience: evaluations without improvement after which the run ends; 0 for never.
        weights: state of each model by its name, when the score was lowest.
    """

    score: float = math.inf
    latest: float = math.inf
    age: int = 0
    patience: int = 0
    weights: dict[str, dict[str, Tensor]] = field(default_factory=dict)

    def consider(self, score: float, models: Mapping[str, nn.Module]) -> None:
        """Copy the present weights if the score is lower than all before."""
        self.latest, self.age = score, self.age + 1
        if score < self.score:
            self.score, self.age = score, 0
            self.weights = {name: _copy(model.state_dict()) for name, model in models.items()}

    @property
    def exhausted(self) -> bool:
        """Whether the score has not improved for `patience` evaluations."""
        return 0 < self.patience <= self.age


def save_checkpoint(
    path: Path,
    models: Mapping[str, nn.Module],
    optimizers: Mapping[str, torch.optim.Optimizer],
    step: int,
    identity: str = "",
    scaler: Scaler | None = None,
    best: Best | None = None,
) -> None:
    """Write models and optimisers by name, and what belongs to the run, as one safetensors file.

    `models`: names have no dot. `optimizers`: names are those of their models. `identity`: what the
    run is trained on.
    """
    best = best or Best()
    tensors = {f"model.{n}.{k}": v for n, m in models.items() for k, v in m.state_dict().items()}
    tensors |= {f"best.{n}.{k}": v for n, state in best.weights.items() for k, v in state.items()}
    for name, optimizer in optimizers.items():
        for number, state in optimizer.state_dict()["state"].items():
            for key, value in state.items():
                tensors[f"optimizer.{name}.{number}.{key}"] = torch.as_tensor(value)
    numbers = {k: getattr(best, k) for k in ("score", "latest", "age", "patience")}
    notes = {"format": FORMAT, "step": str(step), "identity": identity, "best": json.dumps(numbers)}
    if scaler is not None:
        notes["scaler"] = json.dumps(scaler.state_dict())
    with whole_file(path, force=True) as part:
        save_tensors(part, {k: v.contiguous().cpu() for k, v in _copy(tensors).items()}, notes)


class Checkpoint:
    """A file that `save_checkpoint` wrote, to restore a run from.

    Attributes:
        step: number of steps done.
        identity: what the run was trained on.
        best: best weights so far, on the CPU.

    Raises:
        BadInput: the file is damaged or of an earlier version.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self._tensors: dict[str, Tensor] = {}
        try:
            with open_tensors(path) as file:
                self._notes = dict(file.metadata() or {})
                if self._notes.get("format") != FORMAT:
                    raise BadInput(
                        f"{path}: the checkpoint is of another version; train without --resume"
                    )
                for key in file.keys():  # noqa: SIM118 (not a dict)
                    self._tensors[key] = file.get_tensor(key)
            self.step, self.identity = int(self._notes["step"]), self._notes["identity"]
            self.best = Best(**json.loads(self._notes["best"]))
        except (SafetensorError, KeyError, TypeError, ValueError) as error:
            raise BadInput(f"{path}: the checkpoint is damaged; train without --resume") from error
        for name in {key.split(".")[1] for key in self._tensors if key.startswith("best.")}:
            self.best.weights[name] = self._under(f"best.{name}.")

    @property
    def names(self) -> set[str]:
        """Names of the models."""
        return {key.split(".")[1] for key in self._tensors if key.startswith("model.")}

    def restore(
        self, name: str, model: nn.Module, optimizer: torch.optim.Optimizer | None = None
    ) -> None:
        """Restore a model and its optimiser.

        Raises:
            BadInput: the file holds another architecture.
        """
        try:
            model.load_state_dict(self._under(f"model.{name}."))
        except RuntimeError as error:
            raise self.unlike() from error
        if optimizer is None:
            return
        states: dict[int, dict[str, Tensor]] = {}
        for key, value in self._under(f"optimizer.{name}.").items():
            number, _, entry = key.partition(".")
            states.setdefault(int(number), {})[entry] = value
        parameters = [p for group in optimizer.param_groups for p in group["params"]]
        if len(states) > len(parameters):
            raise self.unlike()
        laid = {n: _laid_like(state, parameters[n]) for n, state in states.items()}
        groups = optimizer.state_dict()["param_groups"]
        optimizer.load_state_dict({"state": laid, "param_groups": groups})

    def restore_scale(self, scaler: Scaler) -> None:
        """Restore the loss scale, if the file has one."""
        if "scaler" in self._notes:
            scaler.load_state_dict(json.loads(self._notes["scaler"]))

    def unlike(self) -> BadInput:
        """The error to raise where the run to resume has other models than the file."""
        return BadInput(
            f"{self.path}: a checkpoint of another architecture; train without --resume"
        )

    def _under(self, prefix: str) -> dict[str, Tensor]:
        cut = len(prefix)
        return {key[cut:]: value for key, value in self._tensors.items() if key.startswith(prefix)}


def _copy(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return {name: value.detach().clone() for name, value in state.items()}


def _laid_like(state: dict[str, Tensor], parameter: Tensor) -> dict[str, Tensor]:
    """An optimiser's state of a parameter, in the parameter's order in memory.

    A fused optimiser goes through both side by side and does not look at their strides.
    """
    return {
        name: torch.empty_like(parameter.detach(), dtype=value.dtype, device="cpu").copy_(value)
        if value.shape == parameter.shape
        else value
        for name, value in state.items()
    }


@dataclass(frozen=True)
class Schedule:
    """Adam and its course.

    Attributes:
        rate: learning rate.
        betas: of Adam.
        batch: windows a step.
        epochs: passes over all windows.
        milestones: epochs after which the rate falls to a tenth.
        most_steps: limit on the steps, 0 for none; milestones move in proportion.
        clip: largest norm of the gradients.
    """

    rate: float
    betas: tuple[float, float] = (0.5, 0.999)
    batch: int = 32
    epochs: int = 500
    milestones: tuple[int, ...] = ()
    most_steps: int = 0
    clip: float = 1.0

    def __post_init__(self) -> None:
        if not 0 < self.rate < 1 or not all(0 <= beta < 1 for beta in self.betas):
            raise ValueError("rate and betas must lie between 0 and 1")
        if min(self.batch, self.epochs) < 1 or self.most_steps < 0 or self.clip <= 0:
            raise ValueError("batch, epochs and clip must be positive")
        if min(self.milestones, default=1) < 1 or sorted(set(self.milestones)) != [
            *self.milestones
        ]:
            raise ValueError("milestones are epochs from 1 on, each later than the one before")

    def steps(self, items: int) -> int:
        """Optimiser steps for a dataset of `items` windows."""
        steps = max(1, self.epochs * items // self.batch)
        return min(steps, self.most_steps) if self.most_steps else steps

    def milestone_steps(self, items: int) -> list[int]:
        """Steps at which the rate falls."""
        return [self.steps(items) * epoch // self.epochs for epoch in self.milestones]

    def adam(self, model: nn.Module) -> torch.optim.Adam:
        """The optimiser of the model's parameters."""
        return torch.optim.Adam(model.parameters(), lr=self.rate, betas=self.betas)
