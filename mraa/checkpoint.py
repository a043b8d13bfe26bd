"""Checkpoints of training: tensors and a few words in one safetensors file, nothing pickled."""

import json
from pathlib import Path
from typing import Any, Protocol

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from data_prep.errors import BadInput
from data_prep.output import whole_file


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
