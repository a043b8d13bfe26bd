"""The render session draws what the plain renderer draws, however its motion is cut."""

import copy
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from mraa.fast.gpu import Accelerated
from mraa.fast.session import RenderSession
from mraa.grid import resize_flow, resize_map, warp
from mraa.regions import Regions, regions_from_motion
from mraa.released import load_released, read_checkpoint
from mraa.released_sizes import config_from_released
from mraa.renderer import GeneratorConfig, HourglassConfig, Renderer, RendererConfig
from mraa.training.devices import choose_precision, native_bf16

GOLDEN = Path(__file__).resolve().parents[3].parent / "shared" / "golden"
CPU = torch.device("cpu")
needs_golden = pytest.mark.skipif(not GOLDEN.is_dir(), reason="no golden files beside the project")
needs_bf16 = pytest.mark.skipif(not native_bf16(CPU), reason="no bfloat16 on this machine")


def psnr(value, wanted):
    error = (torch.as_tensor(value).double() - torch.as_tensor(wanted).double()).square().mean()
    return float(-10 * torch.log10(error.clamp_min(1e-20)))


DESIGNS = ["paper", "lite", "deep", "fine"]
"""Designs of generators; "fine" is "deep" with blocks at a half and an occlusion of every pixel."""


def make(design, regions=5, **changes):
    """A small renderer whose norms do something and whose output is not saturated."""
    more = {"refine_blocks": 1, "half_blocks": 1, "fine_occlusion": True}
    sizes = GeneratorConfig(
        "deep" if design == "fine" else design,
        width=16 if design == "paper" else 32,
        bottleneck_blocks=2,
        **more if design == "fine" else {},
    )
    config = RendererConfig(
        regions=regions,
        estimator=HourglassConfig(8, 3, 32),
        flow=HourglassConfig(16, 3, 64),
        generator=sizes,
        affine_mode="sym",
    )
    torch.manual_seed(0)
    renderer = Renderer(replace(config, **changes))
    for module in renderer.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            torch.nn.init.uniform_(module.weight, 0.7, 1.3)
            torch.nn.init.normal_(module.bias, std=0.1)
            torch.nn.init.normal_(module.running_mean, std=0.1)
            torch.nn.init.uniform_(module.running_var, 0.5, 1.5)
    for module in renderer.generator.modules():
        if isinstance(module, torch.nn.Conv2d):
            torch.nn.init.kaiming_normal_(module.weight, 0.5)
    return renderer.eval()


@torch.no_grad()
def poses(renderer, photo, count, seed=0):
    """Regions of the photo, and of `count` frames around them."""
    regions = renderer.estimator(photo)
    random = torch.Generator().manual_seed(seed)
    shift = regions.shift + 0.1 * torch.randn(count, *regions.shift.shape[1:], generator=random)
    scale = 0.7 + 0.6 * torch.rand(count, shift.shape[1], 1, 1, generator=random)
    motion = regions_from_motion(shift, regions.covariance * scale, renderer.config.affine_mode)
    return regions, motion


def picture(height=64, width=64, seed=0):
    random = torch.Generator().manual_seed(seed)
    coarse = torch.rand(1, 3, 8, 8, generator=random)
    return torch.nn.functional.interpolate(coarse, (height, width), mode="bicubic").clamp(0, 1)


def blended(photo, parts, corners):
    """The frames (T, 3, H, W) in float32, blended here from the session's parts."""
    flow = torch.cat([part.flow for part in parts])
    occlusion = torch.cat([part.occlusion for part in parts])
    painted = torch.cat([part.painted for part in parts])
    size = photo.shape[2:]
    field = resize_flow(flow, *size, align_corners=corners)
    shown = resize_map(occlusion, *size, align_corners=corners)
    moved = warp(photo.expand(len(flow), -1, -1, -1), field, align_corners=corners)
    return moved * shown + painted * (1 - shown)


@torch.no_grad()
def plain(renderer, photo, regions, motion, background=None):
    count = len(motion.shift)
    still = Regions(
        *(
            x.expand(count, *x.shape[1:])
            for x in (regions.shift, regions.covariance, regions.affine)
        )
    )
    return renderer(photo.expand(count, -1, -1, -1), still, motion, background)[0]


@pytest.mark.parametrize("corners", [True, False])
@pytest.mark.parametrize("design", DESIGNS)
def test_float32_is_exact(design, corners):
    renderer, photo = make(design, align_corners=corners), picture()
    regions, motion = poses(renderer, photo, 5)
    session = RenderSession(renderer, photo, regions, precision="fp32", batch=2)
    parts = list(session.parts(motion))
    wanted = plain(renderer, photo, regions, motion)
    assert psnr(blended(photo, parts, corners), wanted) > 100
    frames = np.concatenate([part.frames for part in parts])
    pixels = (wanted * 255).round().permute(0, 2, 3, 1).numpy()
    assert frames.dtype == np.uint8 and frames.shape == (5, 64, 64, 3)
    assert np.abs(frames - pixels).max() <= 1 and (frames != pixels).mean() < 1e-3
    assert float(wanted.std()) > 0.05 and psnr(wanted[0], wanted[1]) < 40  # it shows something


def test_a_moving_background():
    renderer, photo = make("lite"), picture()
    regions, motion = poses(renderer, photo, 3)
    background = torch.eye(3) + 0.05 * torch.randn(
        3, 3, 3, generator=torch.Generator().manual_seed(0)
    )
    session = RenderSession(renderer, photo, regions, precision="fp32", batch=2)
    found = blended(photo, list(session.parts(motion, background)), True)
    assert psnr(found, plain(renderer, photo, regions, motion, background)) > 100
    assert psnr(found, plain(renderer, photo, regions, motion)) < 60


def test_without_skips():
    renderer, photo = make("paper", skips=False), picture()
    regions, motion = poses(renderer, photo, 2)
    session = RenderSession(renderer, photo, regions, precision="fp32", batch=2)
    painted = torch.cat([part.painted for part in session.parts(motion)])
    assert psnr(painted, plain(renderer, photo, regions, motion)) > 100


@pytest.mark.parametrize("size", [(96, 64), (64, 128), (160, 160)])
@pytest.mark.parametrize("count", [1, 20])
def test_other_sizes_and_numbers_of_regions(size, count):
    renderer, photo = make("lite", regions=count), picture(*size)
    regions, motion = poses(renderer, photo, 2)
    session = RenderSession(renderer, photo, precision="fp32", batch=2)
    found = blended(photo, list(session.parts(motion)), True)
    assert psnr(found, plain(renderer, photo, regions, motion)) > 100


@needs_bf16
@pytest.mark.parametrize("design", DESIGNS)
def test_bfloat16_is_near(design):
    renderer, photo = make(design), picture()
    regions, motion = poses(renderer, photo, 4)
    session = RenderSession(renderer, photo, regions, precision="bf16")
    found = blended(photo, list(session.parts(motion)), True)
    wanted = plain(renderer, photo, regions, motion)
    assert 40 < psnr(found, wanted) < 90


@pytest.mark.parametrize("precision", ["fp32", pytest.param("bf16", marks=needs_bf16)])
@pytest.mark.parametrize("design", DESIGNS)
def test_the_same_bits_however_the_motion_is_cut(design, precision):
    renderer, photo = make(design), picture()
    regions, motion = poses(renderer, photo, 11)

    def draw(cuts, **options):
        session = RenderSession(renderer, photo, regions, precision=precision, **options)
        ends = zip(cuts[:-1], cuts[1:], strict=True)
        chunks = (motion[first:last] for first, last in ends)
        return np.concatenate(list(session.frames(chunks)))

    whole = draw([0, 11])
    assert len(whole) == 11
    for cuts in ([0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11], [0, 5, 5, 6, 11], [0, 10, 11]):
        assert np.array_equal(draw(cuts), whole)
    for workers in (1, 3):
        assert np.array_equal(draw([0, 11], workers=workers), whole)
    session = RenderSession(renderer, photo, regions, precision=precision)
    apart = [np.concatenate(list(session.frames(motion[i : i + 3]))) for i in range(0, 11, 3)]
    assert np.array_equal(np.concatenate(apart), whole)  # one call for each chunk


def test_the_renderer_is_left_as_it_was():
    renderer = make("paper").train()
    before = copy.deepcopy(renderer.state_dict())
    photo = picture()
    regions, motion = poses(copy.deepcopy(renderer).eval(), photo, 2)
    threads = torch.get_num_threads()
    list(RenderSession(renderer, photo, regions).frames(motion))
    assert renderer.training and torch.get_num_threads() == threads
    for key, value in renderer.state_dict().items():
        assert torch.equal(value, before[key])


@pytest.mark.parametrize("design", DESIGNS)
def test_the_way_of_gpus_is_exact_in_float32(design):
    renderer, photo = make(design), picture()
    regions, motion = poses(renderer, photo, 2)
    before = copy.deepcopy(renderer.state_dict())
    with torch.no_grad():
        draw = Accelerated(renderer, renderer.open(photo, regions), 2, torch.float32)
    parts = draw(motion, torch.eye(3).repeat(2, 1, 1), painted=True)
    wanted = plain(renderer, photo, regions, motion)
    assert psnr(blended(photo, [parts], True), wanted) > 100
    assert np.abs(parts.frames - (wanted * 255).round().permute(0, 2, 3, 1).numpy()).max() <= 1
    for key, value in renderer.state_dict().items():
        assert torch.equal(value, before[key])


def test_without_kernels_the_same_frames_are_drawn(monkeypatch):
    renderer, photo = make("deep"), picture()
    regions, motion = poses(renderer, photo, 5)
    wanted = list(RenderSession(renderer, photo, regions, precision="fp32").parts(motion))
    monkeypatch.setenv("ANGIE_KERNELS", "0")
    session = RenderSession(renderer, photo, regions, precision="fp32", batch=2, workers=3)
    assert isinstance(session.draw, Accelerated)
    found = list(session.parts(motion))
    assert psnr(blended(photo, found, True), blended(photo, wanted, True)) > 100
    whole, frames = (np.concatenate([p.frames for p in parts]) for parts in (wanted, found))
    assert np.abs(whole.astype(int) - frames).max() <= 1


def test_without_kernels_numba_is_not_imported():
    code = """
import sys
import mraa.draw, angie.pipeline
print("numba" in sys.modules)
"""
    environment = {**os.environ, "ANGIE_KERNELS": "0"}
    run = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True
    )
    assert run.stdout.strip() == "False", run.stderr


def test_bad_arguments():
    renderer, photo = make("lite"), picture()
    with pytest.raises(ValueError, match="a photo is"):
        RenderSession(renderer, photo[0])
    with pytest.raises(ValueError, match="there are auto, fp32, bf16, fp16"):
        RenderSession(renderer, photo, precision="half")
    with pytest.raises(ValueError, match="GPUs"):
        choose_precision("fp16", CPU)


@needs_golden
@pytest.mark.parametrize("moving", [True, False])
def test_golden_files(moving):
    io = load_file(GOLDEN / "mraa_small.io.safetensors")
    params = json.loads((GOLDEN / "mraa_small.config.json").read_text())["model_params"]
    renderer = load_released(
        read_checkpoint(GOLDEN / "mraa_small.pth"), config_from_released(params)
    )[0]
    wanted = io["out.prediction" if moving else "out.prediction_static_background"]
    with torch.no_grad():
        driving = renderer.estimator(io["in.driving"])
    for i in range(len(wanted)):
        photo = io["in.source"][i : i + 1]
        session = RenderSession(renderer, photo, precision="fp32", batch=1)
        background = io["out.bg"][i : i + 1] if moving else None
        parts = list(session.parts(driving[i : i + 1], background))
        assert float((blended(photo, parts, False) - wanted[i : i + 1]).abs().max()) < 1e-4
        if moving:
            assert float((parts[0].flow - io["out.optical_flow"][i]).abs().max()) < 1e-4


def test_a_processor_that_onednn_is_told_to_use_less_of_draws_in_float32(monkeypatch):
    monkeypatch.setenv("ONEDNN_MAX_CPU_ISA", "AVX2")
    assert choose_precision("auto", torch.device("cpu")) == torch.float32
