"""Train the shipped renderer's flow and generator on packed frames, by the clock.

    python scripts/train_on_gpu.py FRAMES INITIAL OUT [--seconds 520] [--batch 32] ...

FRAMES is what `pack_frames.py` and `draw_backgrounds.py` wrote, INITIAL a `renderer.safetensors`,
with its architecture in `renderer.json` beside it. Regions stay as they are. New blocks begin as
the identity. The rate falls with the time that has passed as a cosine; for the last part a critic
joins. OUT gets weights in half precision (the moving average `half`, `late`, `final`, and the last
ones themselves, `raw`), two sheets, and the curve as text. SIGTERM ends the training as time does.
"""

import argparse
import dataclasses
import json
import math
import os
import signal
import sys
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from pictures.frames import KINDS, SURE, PairMaker, Pairs, load_frames
from pictures.hands import HandNetwork, best_turns
from pictures.training import Training, drawn, scores
from safetensors.torch import save_file
from torch import Tensor, nn

from mraa.renderer import Renderer

START = time.monotonic()


def say(text: str, file: Any = None) -> None:
    """Print a line at once, and keep it."""
    line = f"{time.monotonic() - START:6.1f}s {text}"
    print(line, flush=True)
    if file is not None:
        print(line, file=file, flush=True)


def measured(model: Renderer, sets: dict[str, Pairs]) -> dict[str, tuple[float, ...]]:
    """PSNR of every set, whole and hands, and how much it gains over the source itself."""
    table = {}
    for name, pairs in sets.items():
        image, _ = drawn(model, pairs.source, pairs.driving)
        here, still = scores(image, pairs), scores(pairs.source, pairs)
        table[name] = (*here, here[0] - still[0], here[1] - still[1])
    return table


def row(table: dict[str, tuple[float, ...]]) -> str:
    """Gains over copying, whole and hands, as text."""
    return " | ".join(f"{k} {v[0]:.2f} (+{v[2]:.2f}, hands +{v[3]:.2f})" for k, v in table.items())


def write_sheet(path: Path, model: Renderer, sets: dict[str, Pairs]) -> None:
    """Source, truth and reconstruction of three pairs of every set, 256 pixels each."""
    rows = []
    for pairs in sets.values():
        pick = torch.linspace(0, len(pairs.source) - 1, 4).long()[1:].to(pairs.source.device)
        source, driving = pairs.source[pick], pairs.driving[pick]
        image, _ = drawn(model, source, driving)
        rows.append(torch.cat([torch.cat(list(x), 2) for x in (source, driving, image)], 1))
    grid = (
        torch.cat(rows, 2)
        if len(rows) < 3
        else torch.cat(
            [torch.cat(rows[i : i + 2], 2) for i in range(0, len(rows) - len(rows) % 2, 2)], 1
        )
    )
    pixels = (grid.clamp(0, 1) * 255).byte().permute(1, 2, 0).cpu().numpy()
    cv2.imwrite(str(path), np.ascontiguousarray(pixels[:, :, ::-1]))


def finish(device: torch.device) -> None:
    """Wait for what other streams compute."""
    if device.type == "cuda":
        torch.cuda.synchronize()


def save(model: nn.Module, path: Path) -> None:
    """Weights in half precision, written whole or not at all."""
    tensors = {
        k: (v.half() if v.dtype == torch.float32 and v.ndim > 1 else v).cpu().contiguous()
        for k, v in model.state_dict().items()
    }
    part = path.with_suffix(".part")
    save_file(tensors, part)
    os.replace(part, path)


def parse() -> argparse.Namespace:
    """Arguments."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    for name in ("frames", "initial", "out"):
        parser.add_argument(name, type=Path)
    parser.add_argument("--natural", type=Path, help="weights of EfficientNet-Lite0")
    parser.add_argument("--hands", type=Path, help="weights of a network that sees hands")
    parser.add_argument("--graphs", type=int, default=1, help="steps as CUDA graphs; 0 for not")
    parser.add_argument("--benchmark", type=int, default=0, help="let cuDNN try its algorithms")
    parser.add_argument("--seconds", type=float, default=520, help="from the script's start")
    parser.add_argument("--steps", type=int, default=0, help="end after so many, for trials")
    parser.add_argument("--batch", type=int, default=32)
    parser.add_argument("--rate", type=float, default=6e-4)
    parser.add_argument("--refine", type=int, default=6)
    parser.add_argument("--half", type=int, default=2)
    parser.add_argument("--bottleneck", type=int, default=6)
    parser.add_argument("--fine", type=int, default=1)
    parser.add_argument("--occlusion-cost", type=float, default=0.5)
    parser.add_argument("--blend", type=float, default=0.5)
    parser.add_argument("--clip", type=float, default=50.0)
    parser.add_argument("--critic", type=float, default=0.3, help="pull; 0 for none")
    parser.add_argument("--alike", type=float, default=0.4, help="pull of the critic's features")
    parser.add_argument("--critic-from", type=float, default=0.45)
    parser.add_argument("--critic-rate", type=float, default=4e-4)
    parser.add_argument("--shares", default="0.4,0.4,0.2", help="signer, avatars, phantom")
    parser.add_argument("--pieces", type=int, default=0, help="files of each kind, for trials")
    parser.add_argument("--fixed", type=int, default=48, help="pairs to validate each kind with")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--check", type=float, default=40.0, help="seconds between validations")
    parser.add_argument("--trials", default="", help="JSON: settings to try, one after the other")
    return parser.parse_args()


def backgrounds(folder: Path, device: torch.device) -> Tensor:
    """The bank (M, 320, 320, 3) uint8 RGB."""
    with np.load(folder / "backgrounds.npz", allow_pickle=False) as file:
        data, ends = file["jpeg"], file["ends"]
    parts = np.split(data, ends[:-1])
    images = [cv2.imdecode(p, cv2.IMREAD_COLOR)[:, :, ::-1] for p in parts]
    return torch.from_numpy(np.stack(images)).to(device)


def course(training: Training, sets: dict[str, Pairs], out: Path, seconds: float) -> None:
    """Train until `seconds` after the script's start, or the steps that are set."""
    given, device = training.given, training.device
    stop = {"now": False}
    signal.signal(signal.SIGTERM, lambda *_: stop.update(now=True))
    begun = time.monotonic()
    length = max(1.0, seconds - (begun - START))
    marks = {0.48: "half", 0.8: "late"}
    written: set[str] = set()
    spoken = checked = begun
    before = 0
    config = dataclasses.asdict(training.config)
    (out / "renderer.json").write_text(json.dumps(config, indent=1))
    with (out / "curve.txt").open("a") as curve:
        say(f"{vars(given)}", curve)
        say("at first  " + row(measured(training.average.model, sets)), curve)
        training.modes()
        while not stop["now"]:
            now = time.monotonic()
            progress = (now - begun) / length
            if given.steps:
                progress = training.steps / given.steps
            if progress >= 1:
                break
            training.step(progress)
            if training.steps % 20 == 0:
                finish(device)
            if now - spoken > 10 or training.steps in (1, 10):
                done = training.steps - before
                spent = time.monotonic() - spoken
                values = " ".join(f"{k} {float(v):.4g}" for k, v in training.seen.items())
                speed = done * given.batch / spent
                say(f"step {training.steps} {speed:.0f} pairs/s {values}", curve)
                if not math.isfinite(float(training.seen["l1"])):
                    say("not a number: back to the average, at a third of the rate", curve)
                    training.renderer.load_state_dict(training.average.model.state_dict())
                    training.optimizer.state.clear()
                    given.rate /= 3
                    for value in training.seen.values():
                        value.zero_()
                spoken, before = time.monotonic(), training.steps
            if now - checked > given.check:
                finish(device)
                say("average   " + row(measured(training.average.model, sets)), curve)
                checked = time.monotonic()
            for mark, name in marks.items():
                if progress >= mark and name not in written:
                    finish(device)
                    written.add(name)
                    save(training.average.model, out / f"{name}.safetensors")
                    if name == "half":
                        write_sheet(out / "half.png", training.average.model, sets)
        finish(device)
        say(f"ended after {training.steps} steps of {given.batch} pairs", curve)
        save(training.average.model, out / "final.safetensors")
        save(training.renderer, out / "raw.safetensors")
        usual = measured(training.average.model, sets)
        say("average   " + row(usual), curve)
        write_sheet(out / "final.png", training.average.model, sets)
        fresh = training.refresh_norms(40 if device.type == "cuda" else 2)
        table = measured(fresh, sets)
        say("own norms " + row(table), curve)
        gain = sum(v[0] + v[1] for v in table.values() if v[1] == v[1])
        if gain > sum(v[0] + v[1] for v in usual.values() if v[1] == v[1]):
            save(fresh, out / "final.safetensors")
            say("final.safetensors has its own norms", curve)


def main() -> None:
    """Decode, train, write."""
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    given = parse()
    given.out.mkdir(parents=True, exist_ok=True)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    if device.type == "cuda":
        torch.backends.cudnn.benchmark = bool(given.benchmark)
        torch.backends.cuda.matmul.allow_tf32 = torch.backends.cudnn.allow_tf32 = True
    name = torch.cuda.get_device_name() if device.type == "cuda" else "CPU"
    say(f"{name}, torch {torch.__version__}, OpenCV {cv2.__version__}, {os.cpu_count()} cores")
    frames = {k: load_frames(given.frames, k, device, given.pieces) for k in KINDS}
    say("decoded " + ", ".join(f"{len(f.pictures)} of {k}" for k, f in frames.items()))
    if given.hands:
        network = HandNetwork(given.hands).to(device, memory_format=torch.channels_last)
        for kind, f in frames.items():
            f.angles, f.scores = best_turns(network, f.pictures, f.centres, f.seen)
            there = f.seen[:, :2]
            sure = float((f.scores > SURE)[there].float().mean())
            say(f"{kind}: {sure:.2f} of {int(there.sum())} hands are surely seen")
        del network
    shares = dict(zip(KINDS, map(float, given.shares.split(",")), strict=True))
    maker = PairMaker(frames, shares, backgrounds(given.frames, device), given.seed)
    sets = {}
    for kind in KINDS:
        for opened in (False, True):
            pairs = maker.fixed(kind, given.fixed, from_open=opened)
            if pairs is not None:
                sets[kind + (" open" if opened else "")] = pairs
    trials = json.loads(given.trials) if given.trials else [{}]
    for number, trial in enumerate(trials):
        values = {**vars(given), **trial}
        mine = argparse.Namespace(**values)
        out = given.out if len(trials) == 1 else given.out / f"trial{number}"
        out.mkdir(exist_ok=True)
        until = given.seconds
        if len(trials) > 1:
            say(f"--- trial {number}: {trial}")
            until = time.monotonic() - START + trial.get("span", 25)
        try:
            course(Training(mine, maker, device), sets, out, until)
        except Exception as error:
            if len(trials) == 1:
                raise
            say(f"trial {number} failed: {type(error).__name__}: {str(error)[:500]}")
        if device.type == "cuda":
            say(f"memory {torch.cuda.max_memory_allocated() / 2**30:.1f} GiB")
            torch.cuda.reset_peak_memory_stats()


if __name__ == "__main__":
    main()
