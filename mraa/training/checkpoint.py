"""Checkpoints of training: tensors and a few words in one safetensors file, nothing pickled.

Moving average of a model's weights, which is steadier than the weights of any one step.

How long a motion stage trains, at what rate, and when its best weights were.
"""

import copy
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from data_prep.errors import BadInput
from data_prep.files import whole_file


class Scaler(Protocol):
    """The loss scale of 16-bit training, `torch.amp.GradScaler`."""

    def state_dict(self) -> dict[str, Any]:
        """Numbers alone."""

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Take over what `state_dict` gave."""


def save_checkpoint(
    path: Path,
    model: nn.Module,
    optimizer: torch.optim.Optimizer,
    step: int,
    identity: str = "",
    scaler: Scaler | None = None,
) -> None:
    """Write model, optimiser, step, identity and loss scale as one safetensors file."""
    tensors = {f"model.{k}": v.detach().clone() for k, v in model.state_dict().items()}
    for number, state in optimizer.state_dict()["state"].items():
        for name, value in state.items():
            tensors[f"optimizer.{number}.{name}"] = torch.as_tensor(value).detach().clone()
    with whole_file(path, force=True) as part:
        notes = {"step": str(step), "identity": identity}
        if scaler is not None:
            notes["scaler"] = json.dumps(scaler.state_dict())
        save_file({k: v.contiguous().cpu() for k, v in tensors.items()}, part, notes)


def checkpoint_identity(path: Path) -> str:
    """What a checkpoint was trained on.

    Raises:
        BadInput: the file is damaged.
    """
    try:
        with safe_open(path, framework="pt") as file:
            return str((file.metadata() or {}).get("identity", ""))
    except SafetensorError as error:
        raise BadInput(f"{path}: the checkpoint is damaged; train without --resume") from error


def load_checkpoint(
    path: Path,
    model: nn.Module,
    optimizer: torch.optim.Optimizer,
    scaler: Scaler | None = None,
) -> int:
    """Restore model, optimiser and loss scale; returns the number of steps done.

    Raises:
        BadInput: the file is damaged or belongs to another architecture.
    """
    states: dict[int, dict[str, Tensor]] = {}
    weights: dict[str, Tensor] = {}
    try:
        with safe_open(path, framework="pt") as file:
            notes = file.metadata()
            step = int(notes["step"])
            for key in file.keys():  # noqa: SIM118 (not a dict)
                kind, _, name = key.partition(".")
                if kind == "model":
                    weights[name] = file.get_tensor(key)
                else:
                    number, _, field = name.partition(".")
                    states.setdefault(int(number), {})[field] = file.get_tensor(key)
        model.load_state_dict(weights)
        if scaler is not None and "scaler" in notes:
            scaler.load_state_dict(json.loads(notes["scaler"]))
    except (SafetensorError, RuntimeError, KeyError, TypeError, ValueError) as error:
        raise BadInput(
            f"{path}: a checkpoint of another architecture or damaged; train without --resume"
        ) from error
    parameters = [p for group in optimizer.param_groups for p in group["params"]]
    laid = {n: _laid_like(state, parameters[n]) for n, state in states.items()}
    groups = optimizer.state_dict()["param_groups"]
    optimizer.load_state_dict({"state": laid, "param_groups": groups})
    return step


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


class AveragedModel(nn.Module):
    """A copy of a model whose weights follow the model's as an exponential moving average.

    The copy and the count of updates are part of the state, so that a resumed run goes on exactly.
    The average of few updates forgets faster, `min(decay, (1 + n) / (10 + n))`, so that the first
    weights do not weigh for long.

    Args:
        model: in training; its parameters may not be replaced.
        decay: part of the average that an update keeps, at most.
    """

    updates: Tensor

    def __init__(self, model: nn.Module, decay: float) -> None:
        super().__init__()
        self.model = copy.deepcopy(model).eval().requires_grad_(False)
        self.decay = decay
        self.register_buffer("updates", torch.zeros(()))

    @torch.no_grad()
    def update(self, model: nn.Module) -> None:
        """Move the average towards the weights and buffers of `model`; whole numbers are copied."""
        self.updates += 1
        share = 1 - torch.clamp((1 + self.updates) / (10 + self.updates), max=self.decay)
        latest = model.state_dict()
        for name, average in self.model.state_dict().items():
            if average.is_floating_point():
                average.lerp_(latest[name], share)
            else:
                average.copy_(latest[name])


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


class BestWeights(nn.Module):
    """A model together with a copy of its weights at the lowest score so far.

    Score, copy and age are buffers, so that a resumed run knows them.

    Args:
        model: the model in training.
    """

    score: Tensor
    latest: Tensor
    age: Tensor

    def __init__(self, model: nn.Module) -> None:
        super().__init__()
        self.model = model
        self.register_buffer("score", torch.tensor(float("inf")))
        self.register_buffer("latest", torch.tensor(float("inf")))
        self.register_buffer("age", torch.zeros((), dtype=torch.int64))
        for name, value in model.state_dict().items():
            self.register_buffer(_copy_of(name), value.detach().clone())
        copies = [_copy_of(name) for name in model.state_dict()]
        self._ddp_params_and_buffers_to_ignore = copies  # equal everywhere, not worth sending

    def forward(self, *inputs: Tensor) -> Tensor:
        """Call the model in training."""
        return self.model(*inputs)

    @torch.no_grad()
    def consider(self, score: float) -> None:
        """Keep the present weights if the score is lower than all before."""
        self.latest.fill_(score)
        self.age += 1
        if score < float(self.score):
            self.score.fill_(score)
            self.age.zero_()
            for name, value in self.model.state_dict().items():
                getattr(self, _copy_of(name)).copy_(value)

    def scores(self) -> dict[str, Tensor]:
        """The latest and the lowest score, for the curves; nothing before the first."""
        return {"held_out": self.latest, "best": self.score} if torch.isfinite(self.score) else {}

    def restore(self) -> None:
        """Put the best weights into the model; without any score they are left as they are."""
        if torch.isfinite(self.score):
            names = self.model.state_dict()
            self.model.load_state_dict({name: getattr(self, _copy_of(name)) for name in names})


def _copy_of(name: str) -> str:
    return "best_" + name.replace(".", "__")
