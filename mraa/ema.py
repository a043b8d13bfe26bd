"""Moving average of a model's weights, which is steadier than the weights of any one step."""

import copy

import torch
from torch import Tensor, nn


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
