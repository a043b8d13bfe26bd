"""How long a motion stage trains, at what rate, and when its best weights were."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn


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
