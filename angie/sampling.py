"""How a code is chosen from logits: greedy or top-k, with a guard against repetition."""

from dataclasses import dataclass, field

import torch
from torch import Tensor

METHODS = ("greedy", "topk")

MOST_REPEATS = 4
"""The repeat guard acts when the last code pair stands there more often than this in a row."""

SILENT_STEPS = 3
"""Steps without sound (0.96 s) after which calm sampling is still."""


@dataclass(frozen=True)
class Sampling:
    """How codes are chosen.

    Attributes:
        method: "greedy" (deterministic, Bailando) or "topk".
        k: most likely codes that may be drawn.
        temperature: divides the logits before drawing.
        repeat_guard: forbid, once, a code pair that stands more than 4 times in a row while
            there is sound.
        calm: take the likeliest code where there is no sound, so that chance moves nobody in
            silence; after a second of it, the codes of stillness.
    """

    method: str = "topk"
    k: int = 20
    temperature: float = 1.0
    repeat_guard: bool = False
    calm: bool = field(default=False, metadata={"later": True})

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise ValueError(f"sampling is one of {', '.join(METHODS)}, not {self.method!r}")
        if self.k < 1 or self.temperature <= 0:
            raise ValueError("top-k needs k >= 1 and a temperature above zero")


def stuck(codes: Tensor) -> bool:
    """Whether the last code pair of (2, S) stands more than four times in a row."""
    run = codes[:, -(MOST_REPEATS + 1) :]
    return run.shape[1] > MOST_REPEATS and bool((run == run[:, :1]).all())


def draw(
    logits: Tensor, codes: Tensor, sampling: Sampling, generator: torch.Generator, voiced: bool
) -> Tensor:
    """Choose the next code pair.

    Ties are broken by the smaller code, so the choice follows from logits and generator alone.

    Args:
        logits: (2, V) of the two streams, on the CPU.
        codes: (2, S) the codes so far.
        sampling: how to choose.
        generator: source of randomness, on the CPU.
        voiced: whether there is sound at this step; the repeat guard acts there alone.

    Returns:
        (2,) int64.
    """
    if sampling.repeat_guard and voiced and stuck(codes):
        logits = logits.scatter(1, codes[:, -1:], float("-inf"))
    if sampling.method == "greedy" or (sampling.calm and not voiced):
        return logits.argmax(-1)
    values, order = logits.sort(dim=-1, descending=True, stable=True)
    values, order = values[:, : sampling.k], order[:, : sampling.k]
    choice = torch.multinomial((values / sampling.temperature).softmax(-1), 1, generator=generator)
    return order.gather(1, choice)[:, 0]
