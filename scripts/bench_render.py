"""How fast frames are drawn: a plain implementation, and what each rewrite of it gains.

    python scripts/bench_render.py [paper] [lite] [--bundle BUNDLE] [--frames N]

The plain path is MRAA's as a reader would write it, kept here: batches of one in float32, the
source encoded anew for every frame. All ways are timed in turn in one run, several rounds, and
each shows its best. Weights are random with the scale of trained ones (norms that have seen the
photo, logits so large that poses differ about as much as a trained renderer's, by 20 dB), or
those of a bundle. PSNR is that of the pictures before they are rounded to 8 bits. Prints a table
for each renderer.
"""

import angie.cli  # noqa: F401 (how OpenMP's threads wait; before torch is imported)

# isort: split
import argparse
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.utils.flop_counter import FlopCounterMode

from angie.bundle import PHOTO, Bundle
from angie.config import preset
from data_prep.media.photo import read_photo
from data_prep.speaker.crop import cut_out, find_faces, speaker_crop
from mraa.blocks import UpBlock
from mraa.fast.folding import PHASES, doubling, fold
from mraa.fast.gpu import Accelerated
from mraa.fast.session import RenderSession
from mraa.grid import resize_flow, resize_map, warp
from mraa.regions import Regions, regions_from_motion
from mraa.renderer import Parts, Renderer, from_pixels
from mraa.training.devices import keep_memory, native_bf16

CPU = torch.device("cpu")
ROUNDS = 3


def picture() -> Tensor:
    """The shipped photo as the networks see it, (1, 3, 256, 256)."""
    photo = read_photo(PHOTO)
    crop = speaker_crop(find_faces(photo)[0], *photo.shape[:2])
    return from_pixels(torch.from_numpy(cut_out(photo, crop))[None])


@torch.no_grad()
def random_renderer(name: str, photo: Tensor) -> Renderer:
    """A renderer of random weights whose norms have seen the photo in some poses."""
    torch.manual_seed(0)
    renderer = Renderer(preset(name).renderer)
    for module in renderer.modules():
        if isinstance(module, nn.Conv2d):
            nn.init.kaiming_normal_(module.weight)
        if isinstance(module, nn.BatchNorm2d):
            module.momentum = None  # plain means
    renderer.train()
    for seed in range(2):
        regions = renderer.estimator(photo)
        renderer(
            photo.expand(2, -1, -1, -1), repeated(regions, 2), poses(renderer, regions, 2, seed)
        )
    renderer.eval()
    regions = renderer.estimator(photo)
    for layer, part in ((renderer.generator.final, 1.0), (renderer.flow.mask, 0.5),
                        (renderer.flow.occlusion, 0.5)):  # fmt: skip
        seen: list[Tensor] = []
        hook = layer.register_forward_hook(lambda _, __, result, seen=seen: seen.append(result))
        renderer(photo, regions, poses(renderer, regions, 1, 0))
        hook.remove()
        layer.weight.mul_(part / seen[0].std())
        layer.bias.zero_()
    return renderer


def repeated(regions: Regions, count: int) -> Regions:
    """Regions (1, K) for `count` frames."""
    return Regions(
        *(
            x.expand(count, *x.shape[1:])
            for x in (regions.shift, regions.covariance, regions.affine)
        )
    )


def poses(renderer: Renderer, regions: Regions, count: int, seed: int = 1) -> Regions:
    """Poses around those of the photo."""
    random = torch.Generator().manual_seed(seed)
    shift = regions.shift + 0.05 * torch.randn(count, *regions.shift.shape[1:], generator=random)
    scale = 0.85 + 0.3 * torch.rand(count, shift.shape[1], 1, 1, generator=random)
    return regions_from_motion(shift, regions.covariance * scale, renderer.config.affine_mode)


@dataclass
class Way:
    """One way to draw frames."""

    text: str
    draw: Callable[[], object]
    frames: int
    """Drawn by one call."""
    parts: Callable[[], list[Parts]] | None = None
    """Draws the first frames in parts, to be compared; None for the plain way."""
    seconds: float = float("inf")
    """A frame, the best of all rounds."""
    worked: float = float("inf")
    """The same in seconds of one processor, which others on the machine do not change."""


@torch.no_grad()
def plain(renderer: Renderer, photo: Tensor, source: Regions, motion: Regions) -> list[Tensor]:
    """The plain path: frames (1, 3, H, W), everything anew for each."""
    return [renderer(photo, source, motion[i : i + 1])[0] for i in range(len(motion.shift))]


class PhaseBlock(nn.Module):
    """An up block with the convolution before the doubling."""

    def __init__(self, block: UpBlock) -> None:
        super().__init__()
        norm = block.norm if isinstance(block.norm, nn.BatchNorm2d) else None
        kernel = doubling(fold(block.conv, norm))
        self.weight = kernel.weight.to(memory_format=torch.channels_last)
        self.bias = kernel.bias

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) to (B, C', 2H, 2W)."""
        height, width = x.shape[2:]
        y = F.conv2d(x, self.weight, self.bias, padding=1).relu_()
        out = y.new_empty(len(y), y.shape[1] // 4, 2 * height, 2 * width)
        out = out.to(memory_format=torch.channels_last)
        for part, (i, j) in zip(y.chunk(4, dim=1), PHASES, strict=True):
            out[:, :, i::2, j::2] = part[:, :, i : i + height, j : j + width]
        return out


def with_phases(draw: Accelerated) -> Accelerated:
    """Put phase blocks in the place of up blocks."""
    for module in list(draw.renderer.modules()):
        for name, child in list(module.named_children()):
            if isinstance(child, UpBlock):
                setattr(module, name, PhaseBlock(child))
    return draw


def one_by_one(draw: Accelerated, motion: Regions) -> list[Parts]:
    """Frames of motion in batches of one, by all threads."""
    still = torch.eye(3)[None]
    return [draw(motion[i : i + 1], still, True) for i in range(len(motion.shift))]


def matrix_rate(dtype: torch.dtype, threads: int) -> float:
    """GFLOP/s of large matrix products, one a thread, the best of several."""
    size, best = 1536, 0.0
    pairs = [torch.randn(2, size, size).to(dtype) for _ in range(threads)]

    def multiply(pair: Tensor) -> None:
        torch.set_num_threads(1)
        for _ in range(3):
            torch.mm(pair[0], pair[1])

    with ThreadPoolExecutor(threads) as pool:
        for _ in range(6):
            begun = time.perf_counter()
            list(pool.map(multiply, pairs))
            best = max(best, threads * 6 * size**3 / (time.perf_counter() - begun) / 1e9)
    torch.set_num_threads(threads)
    return best


def psnr(found: Tensor, wanted: Tensor) -> float:
    """Decibels of pictures in [0, 1]."""
    error = (found.double() - wanted.double()).square().mean()
    return float(-10 * torch.log10(error.clamp_min(1e-20)))


def blended(renderer: Renderer, photo: Tensor, parts: list[Parts]) -> Tensor:
    """Frames in float32 of a session's parts, without the rounding to 8 bits."""
    corners = renderer.config.align_corners
    size = photo.shape[2:]
    flow = resize_flow(torch.cat([p.flow for p in parts]), *size, align_corners=corners)
    shown = resize_map(torch.cat([p.occlusion for p in parts]), *size, align_corners=corners)
    moved = warp(photo.expand(len(flow), -1, -1, -1), flow, align_corners=corners)
    return moved * shown + torch.cat([p.painted for p in parts]) * (1 - shown)


def sessions(renderer: Renderer, photo: Tensor, source: Regions) -> list[tuple[str, RenderSession]]:
    """The session without compiled kernels, with them, and in bfloat16."""
    ways = [("fp32", False, "session without compiled kernels"),
            ("fp32", True, "compiled kernels, a frame a core, minimal filtering")]  # fmt: skip
    if native_bf16(CPU):
        ways.append(("bf16", True, "bfloat16, masks and warps in float32"))
    return [
        (f"{text} ({precision})",
         RenderSession(renderer, photo, source, precision=precision, kernels=kernels))
        for precision, kernels, text in ways
    ]  # fmt: skip


def bench(name: str, renderer: Renderer, photo: Tensor, count: int) -> None:
    """Print the table of one renderer."""
    with torch.no_grad():
        source = renderer.estimator(photo)
        opened = renderer.open(photo, source)
    motion = poses(renderer, source, count)
    few = motion[: max(2, count // 4)]
    folded = Accelerated(renderer, opened, 1, torch.float32)
    phased = with_phases(Accelerated(renderer, opened, 1, torch.float32))
    ways = [Way("plain", lambda: plain(renderer, photo, source, few), len(few.shift))]
    for text, drawer in (
        ("source once, norms folded, channels last", folded),
        ("doubling behind the convolution", phased),
    ):
        draw = partial(one_by_one, drawer, few)
        ways.append(Way(text, draw, len(few.shift), draw))
    for text, session in sessions(renderer, photo, source):
        draw = partial(drawn, session, motion)
        parts = partial(in_parts, session, motion[:8])
        ways.append(Way(text, draw, count, parts))
    for _ in range(ROUNDS):
        for way in ways:
            begun, worked = time.perf_counter(), time.process_time()
            way.draw()
            way.worked = min(way.worked, (time.process_time() - worked) / way.frames)
            way.seconds = min(way.seconds, (time.perf_counter() - begun) / way.frames)
    wanted = torch.cat(plain(renderer, photo, source, motion[:8]))
    report(name, renderer, photo, wanted, ways)


def drawn(session: RenderSession, motion: Regions) -> int:
    """Draw all frames, keep none."""
    return sum(len(frames) for frames in session.frames(motion))


def in_parts(session: RenderSession, motion: Regions) -> list[Parts]:
    """Draw all frames in parts."""
    return list(session.parts(motion))


def report(name: str, renderer: Renderer, photo: Tensor, wanted: Tensor, ways: list[Way]) -> None:
    """Compare pictures with the wanted ones, print."""
    threads = torch.get_num_threads()
    types = [torch.float32] + ([torch.bfloat16] if native_bf16(CPU) else [])
    rates = ", ".join(f"{str(d)[6:]} {matrix_rate(d, threads):.0f} GFLOP/s" for d in types)
    print(f"\n### {name}: {threads} threads, matrix rate {rates}\n")
    print("| step | ms a frame | fps | times plain | processor ms | PSNR |")
    print("|---|---|---|---|---|---|")
    for way in ways:
        quality = ""
        if way.parts is not None:
            found = blended(renderer, photo, way.parts())
            quality = f"{psnr(found, wanted[: len(found)]):.1f}"
        print(
            f"| {way.text} | {1000 * way.seconds:.1f} | {1 / way.seconds:.2f} "
            f"| {ways[0].seconds / way.seconds:.2f} | {1000 * way.worked:.1f} | {quality} |",
            flush=True,
        )


def bench_gpu(name: str, renderer: Renderer, photo: Tensor, count: int) -> None:
    """The same on a GPU: plain against sessions of several batches and types. Not yet measured."""
    device = torch.device("cuda")
    renderer, photo = renderer.to(device), photo.to(device)
    with torch.no_grad():
        source = renderer.estimator(photo)
    motion = poses(renderer.cpu(), Regions(*(x.cpu() for x in (source.shift, source.covariance,
                                                              source.affine))), count)  # fmt: skip
    renderer.to(device)
    motion = Regions(
        motion.shift.to(device), motion.covariance.to(device), motion.affine.to(device)
    )

    def timed(draw: Callable[[], object]) -> float:
        best = float("inf")
        for _ in range(ROUNDS + 1):
            torch.cuda.synchronize()
            begun = time.perf_counter()
            draw()
            torch.cuda.synchronize()
            best = min(best, (time.perf_counter() - begun) / count)
        return best

    size = 8192
    square = torch.randn(size, size, device=device, dtype=torch.float16)
    rate = 2 * size**3 / (timed(lambda: torch.mm(square, square)) * count) / 1e12
    with FlopCounterMode(display=False) as flops:
        plain(renderer, photo, source, motion[:1])
    work = flops.get_total_flops()
    base = timed(lambda: plain(renderer, photo, source, motion))
    print(f"\n### {name}: {torch.cuda.get_device_name()}, matrix rate float16 {rate:.0f} TFLOP/s\n")
    print("| way | batch | ms a frame | fps | times plain | share of the rate (plain's work) |")
    print("|---|---|---|---|---|---|")
    print(
        f"| plain | 1 | {1000 * base:.2f} | {1 / base:.0f} | 1 | {work / base / rate / 1e12:.1%} |"
    )
    for precision in ("fp32", "fp16", "bf16"):
        for batch in (4, 16, 32):
            session = RenderSession(renderer, photo, source, precision=precision, batch=batch)
            seconds = timed(lambda s=session: [len(f) for f in s.frames(motion)])
            print(
                f"| {precision} | {batch} | {1000 * seconds:.2f} | {1 / seconds:.0f} "
                f"| {base / seconds:.2f} | {work / seconds / rate / 1e12:.1%} |",
                flush=True,
            )


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser()
    parser.add_argument("presets", nargs="*", default=["paper", "lite"])
    parser.add_argument("--bundle", type=Path, help="a trained renderer, in place of random ones")
    parser.add_argument("--frames", type=int, default=16, help="drawn by each way, a multiple of 8")
    arguments = parser.parse_args()
    keep_memory()
    photo = picture()
    if arguments.bundle:
        renderers = {str(arguments.bundle): Bundle.open(arguments.bundle).renderer()}
    else:
        renderers = {name: random_renderer(name, photo) for name in arguments.presets}
    for name, renderer in renderers.items():
        bench(name, renderer, photo, arguments.frames)
        if torch.cuda.is_available():
            bench_gpu(name, renderer, photo, 64)


if __name__ == "__main__":
    main()
