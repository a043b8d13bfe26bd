"""What the motion side costs: codes a second with and without the cache, each step's share.

    python scripts/bench_angie.py [SECONDS ...]

Weights are random, which changes no time. The uncached baseline computes the whole window for
every code. Shares are of the length of the sound; features, codes, decoding and refinement
together are all that `angie animate` does before it renders. For each length of sound the growth
of the resident memory above the loaded models is told.
"""

import angie.cli  # noqa: F401 (how OpenMP's threads wait; before torch is imported)

# isort: split
import argparse
import dataclasses
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from angie.bundle import BUNDLE, Bundle
from angie.config import preset
from angie.generators.angie.generate import AngieGenerator
from angie.generators.angie.gpt import CoSpeechGPT
from angie.generators.angie.refiner import Refiner
from angie.generators.angie.sampling import Sampling, Window, continue_codes, draw
from angie.generators.angie.tokenizer import VQMotionExtractor
from angie.layers.packed_linear import pack, packable, product_type
from data_prep.errors import BadInput, call_script
from data_prep.rates import FPS, SAMPLE_RATE, tokens_covering
from data_prep.speech.features import Speech
from mraa.motion import Motion

CODES = 60
"""Codes made for each rate."""


def seconds(work: Callable[[], Any]) -> float:
    """Time of one call."""
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def grown(work: Callable[[], Any]) -> tuple[float, float]:
    """Time of one call, and by how many MB the resident memory grew while it ran."""
    done, sizes = threading.Event(), [resident()]

    def watch() -> None:
        while not done.wait(0.005):
            sizes.append(resident())

    watcher = threading.Thread(target=watch)
    watcher.start()
    taken = seconds(work)
    done.set()
    watcher.join()
    return taken, max(sizes) - sizes[0]


def resident() -> float:
    """Resident memory in MB (Linux)."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6


@torch.no_grad()
def uncached(gpt: CoSpeechGPT, onset: torch.Tensor, sampling: Sampling) -> torch.Tensor:
    """The plain sliding window: every code from a whole forward pass."""
    codes, generator = torch.tensor([[3], [7]]), torch.Generator().manual_seed(0)
    for step in range(1, len(onset)):
        first = max(0, step - gpt.config.block)
        logits = gpt(codes[None, :, first:], onset[None, first + 1 : step + 1])[0, :, -1]
        pair = draw(logits, codes, sampling, generator, False)
        codes = torch.cat([codes, pair[:, None]], dim=1)
    return codes


def generator_of(name: str) -> AngieGenerator:
    """A generator of a preset's sizes with random weights, decoding as the shipped bundle does."""
    sizes, statistics = preset(name).settings("angie"), Bundle.open(BUNDLE).statistics()
    torch.manual_seed(0)
    vq, refiner = VQMotionExtractor(sizes.vq), Refiner(sizes.refiner)
    gpt = CoSpeechGPT(sizes.gpt)
    return AngieGenerator(vq, gpt, refiner, statistics, sizes.generation, chunked=True)


def rates(generator: AngieGenerator, precision: str) -> None:
    """Print codes a second, uncached and with either window."""
    gpt, sampling = generator.gpt, generator.config.sampling
    onset, start = torch.randn(CODES + 1, gpt.config.onset), torch.tensor([[3], [7]])
    uncached(gpt, onset[:4], sampling)
    base = CODES / seconds(lambda: uncached(gpt, onset, sampling))
    print(f"  uncached, nn.Linear    {base:7.1f} codes/s")
    pack(gpt, product_type(precision))
    for name, window in (("slide", Window("slide")), ("hop", Window("hop"))):

        def make(window: Window = window, length: int = CODES + 1) -> None:
            source = torch.Generator().manual_seed(0)
            continue_codes(gpt, start, onset[:length], sampling, source, window=window)

        make(length=4)
        rate = CODES / seconds(make)
        print(f"  cached, {name:<5} window   {rate:7.1f} codes/s  {rate / base:5.2f} times")


def shares(generator: AngieGenerator, length: int, window: str) -> None:
    """Print the parts of the motion side as shares of the sound's length."""
    moving = dataclasses.replace(generator.config, window=Window(window))
    generator = dataclasses.replace(generator, config=moving)
    place = np.arange(length * SAMPLE_RATE, dtype=np.float32)
    noise = np.random.default_rng(0).standard_normal(len(place), np.float32)
    samples = 0.1 * noise * (np.sin(place / 4000) > 0)
    speech = Speech(samples)
    heard, room = grown(lambda: [speech[name] for name in ("onset", "mfcc")])
    onset = torch.from_numpy(speech["onset"][: tokens_covering(length * FPS)])
    codes = torch.randint(generator.vq.config.codes, (2, len(onset)))
    pose = Motion.from_vector(generator.statistics.rest[:1])
    pattern = generator.integrate(generator.decode(codes)[: length * FPS], pose.vector()[0], None)
    mfcc = torch.from_numpy(speech["mfcc"])
    parts = {
        "features": heard,
        "codes": seconds(lambda: generator.draw_codes(onset, 0, None)),
        "decoding": seconds(lambda: generator.decode(codes)),
        "refinement": seconds(lambda: generator.residual(mfcc, pattern)),
    }
    _, more = grown(lambda: generator.generate(speech, pose, length * FPS))
    text = ", ".join(f"{name} {100 * part / length:.2f} %" for name, part in parts.items())
    total = 100 * sum(parts.values()) / length
    print(
        f"  {length:>4} s, {window:<5}  {total:5.2f} % ({text}); memory +{max(room, more):.0f} MB"
    )


def main() -> None:
    """Print the figures of lite and paper; a narrow GPT has no large products."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("seconds", type=int, nargs="*", default=[60, 600], help="of sound (60 600)")
    lengths = parser.parse_args().seconds
    if min(lengths) < 1:
        raise BadInput(f"{min(lengths)} s: give seconds above 0")
    print(f"{torch.get_num_threads()} threads, torch {torch.__version__}")
    for name, precision in (("lite", "auto"), ("paper", "fp32"), ("paper", "auto")):
        generator = generator_of(name)
        kind = packable(product_type(precision)) or torch.float32
        print(f"{name}, large products in {str(kind)[6:]}")
        rates(generator, precision)
        for length in lengths:
            for window in ("hop", "slide"):
                if name == "lite" or length <= 60:
                    shares(generator, length, window)


if __name__ == "__main__":
    call_script(main)
