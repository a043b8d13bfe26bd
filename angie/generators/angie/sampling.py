"""How a code is chosen from logits: greedy or top-k, with a guard against repetition.

A sequence of codes continued over any length of sound, one step at a time.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from angie.generators.angie.gpt import CoSpeechGPT
from data_prep.progress import Step, tell

METHODS = ("greedy", "topk")

VOICES = ("recording", "causal")


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
        voice: what counts as sound: "recording", by the levels of all of it, or "causal", by those
            of the last 8 s and the next 0.3 s.
        calm: take the likeliest code where there is no sound, so that chance moves nobody in
            silence; after a second of it, the codes of stillness.
    """

    method: str = "topk"
    k: int = 20
    temperature: float = 1.0
    repeat_guard: bool = False
    calm: bool = False
    voice: str = "recording"

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise ValueError(f"sampling is one of {', '.join(METHODS)}, not {self.method!r}")
        if self.voice not in VOICES:
            raise ValueError(f"voice is one of {', '.join(VOICES)}, not {self.voice!r}")
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


WINDOWS = ("slide", "hop")


@dataclass(frozen=True)
class Window:
    """What the GPT sees of a sequence that is longer than its block.

    Attributes:
        move: "slide" sees the last `block` codes at every step, as Bailando does. Positions
            restart at zero, so every step of a full window is computed whole. "hop" begins a new
            window with the last `context` codes when one is full and reuses all that it computed
            until that one is full: it sees `context` to `block` codes, and how fast people move
            follows how many it sees.
        context: codes that a new window begins with under "hop".
    """

    move: str = "slide"
    context: int = 6

    def __post_init__(self) -> None:
        if self.move not in WINDOWS:
            raise ValueError(f"window is one of {', '.join(WINDOWS)}, not {self.move!r}")
        if self.context < 1:
            raise ValueError("a window begins with at least one code")

    def kept(self, block: int) -> int:
        """Codes that stay when a window of `block` steps is full."""
        return block if self.move == "slide" else min(self.context, block)


@torch.no_grad()
def continue_codes(
    gpt: CoSpeechGPT,
    start: Tensor,
    onset: Tensor,
    sampling: Sampling,
    generator: torch.Generator,
    *,
    voiced: Tensor | None = None,
    window: Window | None = None,
    speaker: int | None = None,
    still: Tensor | None = None,
) -> Tensor:
    """Continue a sequence of codes over all the sound.

    Inside a window one step is computed at a time, with the keys and values of the steps before
    it kept. Time is linear in the length, memory beside the codes constant.

    Args:
        gpt: in evaluation mode.
        start: (streams, P) int64, the first P >= 1 codes.
        onset: (S, 426) standardised onset features of all steps.
        sampling: how to choose a code.
        generator: source of randomness, on the CPU.
        voiced: (S,) bool, steps with sound, see `Sampling`; None: all.
        window: what is seen of a long sequence; None slides.
        speaker: place in the training set's speakers, for joint models; None is anyone.
        still: (streams,) codes of stillness, for calm sampling in long silence.

    Returns:
        (streams, S) int64 codes on the CPU; the first are `start`.
    """
    block, device = gpt.config.block, gpt.positions.device
    kept = (window or Window()).kept(block)
    begin, steps = start.shape[1], len(onset)
    codes = torch.empty(len(start), max(begin, steps), dtype=torch.int64)
    codes[:, :begin] = start
    who = None if speaker is None else torch.tensor([speaker], device=device)
    cache = gpt.cache(1)
    silent = 0
    first = max(0, begin - block)  # of the steps that are not in the cache
    for step in range(begin, steps):
        if cache.full:
            cache.steps, first = 0, step - kept
        seen = codes[None, :, first:step].to(device)
        sound = onset[None, first + 1 : step + 1].to(device)
        logits = gpt.advance(seen, sound, cache, who)[0].float().cpu()  # (streams, V)
        heard = voiced is None or bool(voiced[step])
        codes[:, step] = draw(logits, codes[:, :step], sampling, generator, heard)
        silent = 0 if heard else silent + 1
        if sampling.calm and still is not None and silent > SILENT_STEPS:
            codes[:, step] = still
        first = step
        tell(Step("gestures", step + 1, steps, "codes"))
    return codes[:, :steps]
