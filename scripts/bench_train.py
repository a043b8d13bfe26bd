"""How fast the renderer trains: a plain implementation of the step, and what each change gains.

    python scripts/bench_train.py [paper] [lite] [--device cuda] [--passes N] [--rounds N]

The plain step is MRAA's as a reader would write it, kept here: float32, channels first, eager, the
C library's own memory settings. Every way runs in a process of its own, on pictures and weights of
the same seed, all of them in turn in every pass, and shows its best step. `paper` is compared by a
network of VGG19's size (of random weights, which cost the same), other presets by what their
settings name.
Then: where the time of the trained step goes (each part forward and backward by itself), its
GFLOP and share of the machine's matrix rate, measured here too, and how fast pairs are loaded with
and without the model. Prints Markdown tables.
"""

import angie.cli  # noqa: F401 (how OpenMP's threads wait; before torch is imported)

# isort: split
import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor
from torch.utils.flop_counter import FlopCounterMode
from torchvision.models import vgg19

from angie.bundle import PHOTO
from angie.config import preset
from data_prep.dataset import (
    MANIFEST,
    TABLE,
    Clip,
    Dataset,
    encode_frame,
    write_frames,
    write_table,
)
from data_prep.media.photo import read_photo
from data_prep.rates import FPS
from mraa.flow import Flow
from mraa.losses import TPS_NUMBERS, equivariance_of, thin_plate
from mraa.perceptual import PerceptualPyramid, Vgg, bands_distance
from mraa.regions import Regions
from mraa.renderer import Renderer
from mraa.training.devices import keep_memory
from mraa.training.objective import Objective, RendererTraining, images
from mraa.training.pairs import FramePairs, TrainingPair
from mraa.training.renderer import adam, perceptual_loss
from mraa.training.run import Run, RunConfig, native_precision

BATCH = {"paper": 4, "lite": 8}

WAYS = {
    "plain": "plain: float32, channels first, eager",
    "memory": "the same, memory kept between steps",
    "layout": "channels last and one optimiser kernel besides",
    "mixed": "bfloat16 besides: as `angie train` does it",
}


def plain_loss(
    renderer: Renderer,
    weights: RendererTraining,
    compare: PerceptualPyramid,
    frames: Tensor,
    tps_noise: Tensor,
) -> Tensor:
    """The loss of MRAA as a reader would write it, float32 and channels first."""
    source, driving = (x.permute(0, 3, 1, 2).float().contiguous() / 255 for x in frames.unbind(1))
    both = renderer.estimator(torch.cat([source, driving]))
    source_regions, driving_regions = both[: len(source)], both[len(source) :]
    background = renderer.background(source, driving)
    prediction, _ = renderer(source, source_regions, driving_regions, background)
    equal = equivariance_of(
        renderer.estimator,
        driving,
        driving_regions,
        thin_plate(tps_noise),
        align_corners=renderer.config.align_corners,
    )
    loss = plain_perceptual(compare, prediction, driving)
    loss = loss + weights.equivariance_shift * equal.shift
    return loss + weights.equivariance_affine * equal.affine


def plain_perceptual(compare: PerceptualPyramid, prediction: Tensor, truth: Tensor) -> Tensor:
    """Sum over scales and layers of mean absolute differences of features."""
    total = prediction.new_zeros(())
    for scale, down in zip((1.0, 0.5, 0.25, 0.125), compare.pyramid.downs, strict=True):
        if compare.vgg is not None and scale in compare.scales:
            for a, b in zip(compare.vgg(down(prediction)), compare.vgg(down(truth)), strict=True):
                total = total + F.l1_loss(a, b)
    if compare.bands:
        total = total + bands_distance(compare.pyramid(prediction), compare.pyramid(truth))
    return compare.weight * total


class Bench:
    """One renderer, its losses, pictures and optimiser, and one way to take a step."""

    def __init__(self, name: str, way: str, device: str, batch: int) -> None:
        self.device, self.batch, settings = torch.device(device), batch, preset(name)
        self.plain, self.weights = way in ("plain", "memory"), settings.train_renderer
        native = native_precision(device) == "bf16-mixed"
        self.half = way == "mixed" and native
        if way != "plain":
            keep_memory()
        torch.manual_seed(0)
        layout = torch.contiguous_format if self.plain else torch.channels_last
        to: dict[str, Any] = {"device": self.device, "memory_format": layout}
        self.renderer = Renderer(settings.renderer).to(**to)
        self.compare = perceptual_loss(self.weights)
        if name == "paper":
            self.compare = PerceptualPyramid("random_vgg", width=1, weight=self.weights.perceptual)
            self.compare.vgg = Vgg(vgg19().features)
        self.compare = self.compare.to(**to)
        self.objective = Objective(self.renderer, self.weights, self.compare)
        self.optimizer = adam(self.renderer, self.weights, fused=not self.plain)
        self.frames = torch.stack([pair_of_photo(i) for i in range(batch)]).to(self.device)
        self.tps_noise = torch.randn(batch, TPS_NUMBERS).to(self.device)

    def mixed(self) -> Any:
        """Autocast to bfloat16, where this way and the machine have it."""
        return torch.autocast(self.device.type, torch.bfloat16) if self.half else nullcontext()

    def loss(self, frames: Tensor, tps_noise: Tensor) -> Tensor:
        """The loss of a batch."""
        if self.plain:
            return plain_loss(self.renderer, self.weights, self.compare, frames, tps_noise)
        with self.mixed():
            terms = self.objective(frames, tps_noise)
        terms.pop("l1")
        return torch.stack(list(terms.values())).sum()

    def update(self) -> None:
        """Clip the gradients and step."""
        torch.nn.utils.clip_grad_norm_(self.renderer.parameters(), self.weights.clip)
        self.optimizer.step()
        self.optimizer.zero_grad()

    def step(self) -> float:
        """One step of training; the loss."""
        loss = self.loss(self.frames, self.tps_noise)
        loss.backward()
        self.update()
        return loss.item()

    def wait(self) -> None:
        """Until the device has done what it was told."""
        if self.device.type == "cuda":
            torch.cuda.synchronize()

    def seconds(self, work: Callable[[], Any], rounds: int, warm: int = 1) -> float:
        """The best of some rounds, after some that do not count."""
        times = []
        for _ in range(warm + rounds):
            self.wait()
            begun = time.perf_counter()
            work()
            self.wait()
            times.append(time.perf_counter() - begun)
        return min(times[warm:])


def pair_of_photo(number: int) -> Tensor:
    """The shipped photo at two places: (2, 256, 256, 3) uint8."""
    photo = read_photo(PHOTO)
    side = min(photo.shape[:2]) - 64
    cuts = [photo[k : k + side, number % 32 + k : number % 32 + k + side] for k in (0, 16)]
    return torch.from_numpy(np.stack([cv2.resize(c, (256, 256)) for c in cuts]))


def parts(bench: Bench) -> Iterator[tuple[str, Callable[[], Tensor]]]:
    """Name and forward pass of every part of the step, on inputs that want gradients."""
    renderer, (source, driving) = bench.renderer, images(bench.frames)
    with torch.no_grad(), bench.mixed():
        both = renderer.estimator(torch.cat([source, driving]))
        background = renderer.background(source, driving)
        a, b = both[: len(source)], both[len(source) :]
        flow = renderer.flow(source, a, b, background)
        made = renderer.generator(source, flow)

    def leaf(x: Tensor) -> Tensor:
        return x.detach().clone().requires_grad_()

    def leaves(r: Regions) -> Regions:
        return Regions(leaf(r.shift), leaf(r.covariance), leaf(r.affine))

    def estimator() -> Tensor:
        found = renderer.estimator(torch.cat([source, driving]))
        return found.shift.sum() + found.affine.sum()

    def equivariance() -> Tensor:
        transform, corners = thin_plate(bench.tps_noise), renderer.config.align_corners
        terms = equivariance_of(
            renderer.estimator, driving, leaves(b), transform, align_corners=corners
        )
        return terms.shift + terms.affine

    def flow_predictor() -> Tensor:
        found = renderer.flow(source, leaves(a), leaves(b), leaf(background))
        return found.flow.sum() + found.occlusion.sum()

    def generator() -> Tensor:
        fields = (flow.flow, flow.occlusion, flow.masks, flow.blend, flow.features)
        return renderer.generator(source, Flow(*map(leaf, fields))).sum()

    yield "region estimator (both frames)", estimator
    yield "equivariance (a third, transformed frame)", equivariance
    yield "background", lambda: renderer.background(source, driving).sum()
    yield "flow predictor", flow_predictor
    yield "image generator", generator
    yield "perceptual loss", lambda: bench.compare(leaf(made), driving)


def part_seconds(bench: Bench, forward: Callable[[], Tensor], rounds: int) -> tuple[float, float]:
    """Seconds of a part forward, and forward and backward."""

    def ahead() -> Tensor:
        with bench.mixed():
            return forward()

    def both() -> None:
        ahead().backward()

    whole = bench.seconds(both, rounds)
    once = bench.seconds(ahead, rounds, warm=0)
    bench.optimizer.zero_grad()
    return once, whole


def matrix_rate(bench: Bench, dtype: torch.dtype) -> float:
    """FLOP a second of a large matrix product."""
    size = 4096 if bench.device.type == "cpu" else 8192
    a, b = (torch.randn(size, size, device=bench.device).to(dtype) for _ in range(2))
    return 2 * size**3 / bench.seconds(lambda: a @ b, 5)


def small_dataset(folder: Path) -> Dataset:
    """Two clips of the drifting photo."""
    (folder / "frames").mkdir(parents=True)
    clips = [Clip(f"c{i}", "photo", "train", "photo", 0.0, 32) for i in range(2)]
    for clip in clips:
        frames = [encode_frame(pair_of_photo(i)[0].numpy()) for i in range(clip.n_frames)]
        write_frames(folder / "frames" / f"{clip.id}.safetensors", frames)
    (folder / MANIFEST).write_text(json.dumps({"format": 2}))
    write_table(folder / TABLE, clips, FPS)
    return Dataset(folder)


def loading(bench: Bench, workers: int, steps: int) -> tuple[float, float]:
    """Images a second, loaded without and with the model."""

    def nothing(pair: TrainingPair) -> None:
        pass

    def train(pair: TrainingPair) -> None:
        bench.loss(pair.frames, pair.tps_noise).backward()
        bench.update()

    rates = []
    with tempfile.TemporaryDirectory() as name:
        data = small_dataset(Path(name) / "data")
        pairs = FramePairs(data, data.clips(), bench.weights.augmentation)
        config = RunConfig(device=bench.device.type, workers=workers)
        for work, count in ((nothing, 20 * steps), (train, steps)):
            run = Run(Path(name) / "run", "bench", steps=count, config=config)
            batches = run.batches(pairs, bench.batch)
            work(next(batches))  # workers have started, memory is there
            bench.wait()
            begun = time.perf_counter()
            for _ in range(count):
                work(next(batches))
            bench.wait()
            rates.append(2 * bench.batch * count / (time.perf_counter() - begun))
    return rates[0], rates[1]


def measure(name: str, way: str, device: str, batch: int, rounds: int) -> dict[str, Any]:
    """What one process measures."""
    bench = Bench(name, way, device, batch)
    with FlopCounterMode(display=False) as counter:
        first = bench.step()
    seconds = bench.seconds(bench.step, rounds, warm=0 if bench.plain else 1)
    result = {"loss": first, "flop": counter.get_total_flops(), "seconds": seconds}
    if way != "mixed":
        return result
    rows = [(text, *part_seconds(bench, forward, rounds)) for text, forward in parts(bench)]
    bench.loss(bench.frames, bench.tps_noise).backward()
    kept = {p: p.grad.clone() for p in bench.renderer.parameters() if p.grad is not None}

    def update() -> None:
        for parameter, gradient in kept.items():
            parameter.grad = gradient
        bench.update()

    rows.append(("clipping and optimiser", 0.0, bench.seconds(update, rounds)))
    result["parts"] = rows
    result["rates"] = [matrix_rate(bench, kind) for kind in (torch.float32, torch.bfloat16)]
    result["loading"] = loading(bench, 0 if device == "cpu" else 8, 2)
    return result


def report(name: str, device: str, batch: int, rounds: int, passes: int) -> None:
    """Measure a preset in every way and print its tables."""
    results: dict[str, dict[str, Any]] = {}
    for way in passes * list(WAYS):
        command = [sys.executable, __file__, name, "--device", device, "--batch", str(batch)]
        command += ["--rounds", str(rounds), "--way", way]
        done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
        found = json.loads(done.stdout.splitlines()[-1])
        if way not in results or found["seconds"] < results[way]["seconds"]:
            results[way] = found
    plain, ours = results["plain"]["seconds"], results["mixed"]
    print(f"\n`{name}`, batches of {batch} pairs, {device}, {torch.get_num_threads()} threads\n")
    print("| step | s | images/s | times plain | first loss |\n|---|---|---|---|---|")
    for way, text in WAYS.items():
        seconds, loss = results[way]["seconds"], results[way]["loss"]
        rate, ratio = 2 * batch / seconds, plain / seconds
        print(f"| {text} | {seconds:.2f} | {rate:.2f} | {ratio:.2f} | {loss:.3f} |")
    print("\n| part, by itself | forward, s | backward, s | of the step |\n|---|---|---|---|")
    for text, forward, whole in ours["parts"]:
        share = whole / ours["seconds"]
        print(f"| {text} | {forward:.3f} | {whole - forward:.3f} | {share:.0%} |")
    rate = ours["flop"] / ours["seconds"]
    single, half = ours["rates"]
    print(
        f"\n{ours['flop'] / 1e9:.0f} GFLOP a step, {rate / 1e9:.0f} GFLOP/s: {rate / half:.0%} of "
        f"the bfloat16 matrix rate measured here ({half / 1e9:.0f} GFLOP/s; float32 "
        f"{single / 1e9:.0f}). Plain: {results['plain']['flop'] / plain / single:.0%} of float32's."
    )
    without, within = ours["loading"]
    print(f"Loading: {without:.0f} images/s without the model, {within:.2f} with it.", flush=True)


def main() -> None:
    """Print the tables of the presets that are named."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("presets", nargs="*", default=["paper", "lite"])
    parser.add_argument("--device", default="")
    parser.add_argument("--batch", type=int, default=0)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--passes", type=int, default=1)
    parser.add_argument("--way", choices=WAYS, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.way:
        name, way, device = asked.presets[0], asked.way, asked.device
        print(json.dumps(measure(name, way, device, asked.batch, asked.rounds)))
        return
    devices = [asked.device] if asked.device else ["cpu", "cuda"][: 1 + torch.cuda.is_available()]
    for device in devices:
        for name in asked.presets:
            batch = asked.batch or (BATCH.get(name, 8) if device == "cpu" else 14)
            report(name, device, batch, asked.rounds, asked.passes)


if __name__ == "__main__":
    main()
