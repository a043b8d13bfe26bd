"""Batch norm over the batch of all processes, for devices where torch has none (the CPU)."""

from typing import Any

import torch
import torch.distributed as dist
from torch import Tensor, nn
from torch.nn.modules.batchnorm import _BatchNorm


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
