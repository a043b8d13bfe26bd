"""Devices, processes and precision of training and rendering.

Batch norm over the batch of all processes, for devices where torch has none (the CPU), and the C
library's allocator, told to keep the memory of large tensors between steps.
"""

import ctypes
import logging
import os
import re
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import torch
import torch.distributed as dist
from torch import Tensor, nn
from torch.nn.modules.batchnorm import _BatchNorm

from data_prep.errors import BadInput

if TYPE_CHECKING:
    from lightning_fabric import Fabric

PRECISIONS = {"fp32": torch.float32, "bf16": torch.bfloat16, "fp16": torch.float16}
"""Types of the convolutions, by name."""


def native_bf16(device: torch.device) -> bool:
    """Whether a device multiplies bfloat16 itself, in place of emulating it."""
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    if device.type == "cpu":
        limit = os.environ.get("ONEDNN_MAX_CPU_ISA", "ALL").upper()  # what oneDNN may use of it
        if not re.search("ALL|DEFAULT|BF16|FP16|AMX|AVX10", limit):
            return False
        names = ("_is_avx512_bf16_supported", "_is_amx_tile_supported")  # torch 2.6 and newer
        return any(getattr(torch.cpu, name, bool)() for name in names)
    return False


def choose_precision(name: str, device: torch.device) -> torch.dtype:
    """Type of the convolutions for "auto", "fp32", "bf16" or "fp16" on a device.

    Raises:
        ValueError: an unknown name, or a type that the device has not.
    """
    if name == "auto":
        if native_bf16(device):
            return torch.bfloat16
        return torch.float16 if device.type == "cuda" else torch.float32
    if name not in PRECISIONS:
        raise ValueError(f"there are auto, {', '.join(PRECISIONS)}")
    if name == "bf16" and not native_bf16(device):
        raise ValueError(f"this {device.type} has no bfloat16 of its own; take auto or fp32")
    if name == "fp16" and device.type == "cpu":
        raise ValueError("float16 is for GPUs; take auto or fp32")
    return PRECISIONS[name]


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


def launch(config: RunConfig, *, unused_parameters: bool = False) -> "Fabric":
    """Start (or join) the processes that a configuration asks for.

    Args:
        config: device, processes, precision.
        unused_parameters: some parameters of a model may be left without gradients.

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
            strategy=DDPStrategy(find_unused_parameters=unused_parameters)
            if devices * nodes > 1
            else "auto",
        )
        fabric.launch()
    except (ValueError, RuntimeError, MisconfigurationException) as error:
        reason = str(error).splitlines()[0]
        raise BadInput(f"--device, --devices or --precision: {reason}") from error
    return fabric


class _Total(torch.autograd.Function):
    """Sum of a tensor over all processes; so are its gradients."""

    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        total = x.contiguous().clone()
        dist.all_reduce(total)
        return total

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        total = gradients[0].contiguous().clone()
        dist.all_reduce(total)
        return total


class SyncNorm(_BatchNorm):
    """Batch norm whose statistics in training are those of all processes' batches together.

    Takes the place of a `BatchNorm` with the same tensors under the same names. Every process has
    to hold a share of the same size.
    """

    def _check_input_dim(self, input: Tensor) -> None:
        """Any (B, C, ...) will do."""

    @classmethod
    def of(cls, norm: _BatchNorm) -> "SyncNorm":
        """The synchronised version of a norm, which shares its parameters and buffers."""
        made = cls(norm.num_features, norm.eps, norm.momentum)
        made.weight, made.bias = norm.weight, norm.bias
        for name, buffer in norm.named_buffers():
            made.register_buffer(name, buffer)
        return made.train(norm.training)

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, ...) to the same shape and dtype."""
        if not self.training:
            return super().forward(x)
        processes = dist.get_world_size()
        axes = [0, *range(2, x.dim())]
        shape = [1, -1, *[1] * (x.dim() - 2)]
        with torch.autocast(x.device.type, enabled=False):
            y = x.float()
            mean = _Total.apply(y.mean(axes)) / processes
            y = y - mean.view(shape)
            variance = _Total.apply(y.square().mean(axes)) / processes
            self._track(mean.detach(), variance.detach(), processes * x.numel() // x.shape[1])
            y = y * (torch.rsqrt(variance + self.eps) * self.weight).view(shape)
            return (y + self.bias.view(shape)).to(x.dtype)

    def _track(self, mean: Tensor, variance: Tensor, count: int) -> None:
        """Move the running statistics as `BatchNorm` does: the variance is the unbiased one."""
        assert self.running_mean is not None and self.running_var is not None
        assert self.num_batches_tracked is not None and self.momentum is not None
        self.num_batches_tracked.add_(1)
        self.running_mean.lerp_(mean, self.momentum)
        self.running_var.lerp_(variance * count / max(1, count - 1), self.momentum)


def synchronise(model: nn.Module) -> None:
    """Replace every batch norm inside `model` by its synchronised version, in place."""
    for parent in list(model.modules()):
        for name, child in parent.named_children():
            if isinstance(child, _BatchNorm) and not isinstance(child, SyncNorm):
                setattr(parent, name, SyncNorm.of(child))


_TRIM_THRESHOLD, _TOP_PAD, _MMAP_THRESHOLD = -1, -2, -3  # glibc's malloc.h


def keep_memory(threshold: int = 1 << 30, pad: int = 256 << 20) -> bool:
    """Make glibc reuse freed memory in place of returning it to the system.

    Activations of a training step are large; by default each is mapped and unmapped anew, and
    the system clears its pages every time. Does nothing where the C library is not glibc.

    Args:
        threshold: bytes below which memory is kept.
        pad: bytes that are taken from the system at a time.

    Returns:
        Whether the settings were taken.
    """
    if sys.platform != "linux":
        return False
    library = ctypes.CDLL(None)
    if not hasattr(library, "gnu_get_libc_version") or not hasattr(library, "mallopt"):
        return False
    settings = ((_MMAP_THRESHOLD, threshold), (_TRIM_THRESHOLD, threshold), (_TOP_PAD, pad))
    return all(library.mallopt(name, value) == 1 for name, value in settings)
