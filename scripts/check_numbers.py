"""Whether region motion, the flow predictor and training stay finite on the worst of inputs.

python scripts/check_numbers.py [--motions 10000000] [--hardest 20000] [--steps 2000] [--seed 0]

motions   random factors as an integration may leave them (any sign, axes from 1e-8 to 1e3, nearly
          singular, equal axes) through floor, covariance, bounds and roots: finite, and positive
          definite where a renderer sees them
hardest   those whose affine maps stretch most, through the flow predictor in float32 and bfloat16
steps     training on black frames, still clips, one white pixel, a collapsed region and a codebook
          of one code: no loss and no weight that is not finite
"""

import argparse
import sys
import time
from dataclasses import replace

import numpy as np
import torch
from fuzzing.tokeniser_angie import hostile_training
from torch import Tensor

from angie.config import preset
from mraa.affine import (
    MAX_AXIS_RATIO,
    MIN_AXIS,
    ROOTS,
    affine_from_covariance,
    encode_cholesky,
    inverse,
    relative_affine,
    renderable,
)
from mraa.flow import FlowPredictor
from mraa.motion import Motion, positive, render_floor
from mraa.regions import Regions
from mraa.renderer import Renderer
from mraa.training.objective import Objective, RendererTraining
from mraa.training.renderer import adam, perceptual_loss

BATCH = 200_000
REGIONS = 20


class Fault(Exception):
    """A number that is not as it should be."""


def check(good: Tensor, what: str) -> None:
    """Refuse anything but true everywhere."""
    if not bool(good.all()):
        raise Fault(f"{what}: {int((~good).sum())} of {good.numel()}")


def random_motion(count: int, generator: torch.Generator) -> Motion:
    """Factors (n, 1, 3) and shifts (n, 1, 2), as nobody would train them but sums may make them."""
    numbers = torch.rand(count, 6, generator=generator)
    size = 10.0 ** (numbers[:, :3] * 11 - 8)
    sign = torch.where(numbers[:, 3:] < torch.tensor([0.1, 0.5, 0.1]), -1.0, 1.0)
    factor = size * sign
    kind = torch.randint(6, (count,), generator=generator)
    factor[kind == 1, 2] = 0.0  # singular
    factor[kind == 2, 1] = 0.0
    factor[kind == 2, 2] = factor[kind == 2, 0]  # a circle
    factor[kind == 3] = 0.0  # collapsed
    shift = (torch.rand(count, 2, generator=generator) - 0.5) * 20
    return Motion(shift[:, None], factor[:, None])


def check_motions(count: int, hardest: int, seed: int) -> Regions:
    """All through the roots; the regions that stretch most."""
    generator = torch.Generator().manual_seed(seed)
    kept: list[tuple[Tensor, Tensor]] = []
    low, high = torch.tensor([[0.02, 0.02]]), torch.tensor([[0.3, 0.3]])
    for first in range(0, count, BATCH):
        motion = positive(random_motion(min(BATCH, count - first), generator))
        check(motion.cholesky[..., ::2] > 0, "diagonal above 0")
        floored = render_floor(motion, low, high)
        check(floored.cholesky[..., ::2] >= 0.3 * low.min() * 0.999, "floor")
        for given in (motion, floored):
            covariance = given.covariance()
            check(covariance.isfinite(), "covariance finite")
            factors = encode_cholesky(covariance)
            check(factors.isfinite() & (factors[..., :1] > 0), "factors")
            seen = renderable(covariance)
            values = torch.linalg.eigvalsh(seen.double())
            check(values[..., 0] >= MIN_AXIS**2 * 0.99, "shortest axis")
            check(values[..., 1] <= values[..., 0] * MAX_AXIS_RATIO**2 * 1.02, "ratio of axes")
            for name in ROOTS:
                root = affine_from_covariance(seen, name)
                error = (root @ root.mT - seen).abs().amax((-1, -2))
                check(root.isfinite(), f"{name} root finite")
                check(error <= 1e-3 * seen.abs().amax((-1, -2)), f"{name} root squared")
                check(inverse(root).isfinite(), f"inverse of {name} root")
        shift, wild = motion.shift[:, 0], renderable(motion.covariance())[:, 0]
        affine = affine_from_covariance(wild)
        stretch = relative_affine(affine.roll(1, 0), affine, revert_axis_swap=True).abs()
        worst = stretch.amax((-1, -2)).topk(min(hardest, len(stretch))).indices
        kept.append((shift[worst], wild[worst]))
        if sum(len(one) for one, _ in kept) > 4 * hardest:
            kept = [_worst(kept, hardest)]
    shift, covariance = _worst(kept, hardest)
    return Regions(shift, covariance, affine_from_covariance(covariance))


def _worst(kept: list[tuple[Tensor, Tensor]], count: int) -> tuple[Tensor, Tensor]:
    shift, covariance = (torch.cat(parts) for parts in zip(*kept, strict=True))
    size = covariance.abs().amax((-1, -2))
    order = size.argsort()
    ends = torch.cat([order[: count // 2], order[-(count - count // 2) :]])  # smallest and largest
    return shift[ends], covariance[ends]


def check_flow(regions: Regions, seed: int) -> None:
    """The hardest regions, twenty a frame, source and driving from opposite ends."""
    torch.manual_seed(seed)
    flow = FlowPredictor(REGIONS, width=8, blocks=2, max_width=32).eval()
    count = len(regions.shift) // REGIONS * REGIONS
    order = torch.randperm(count)
    parts = [x[order].unflatten(0, (-1, REGIONS)) for x in (regions.shift, regions.covariance)]
    driving = Regions(*parts, affine_from_covariance(parts[1]))
    source = Regions(*(x.roll(1, 0) for x in (driving.shift, driving.covariance, driving.affine)))
    for dtype in (torch.float32, torch.bfloat16):
        for first in range(0, len(parts[0]), 100):
            piece = slice(first, first + 100)
            images = torch.rand(len(driving.shift[piece]), 3, 64, 64)
            with torch.no_grad(), torch.autocast("cpu", dtype, enabled=dtype != torch.float32):
                made = flow(images, source[piece], driving[piece])
            for name in ("flow", "occlusion", "masks", "blend"):
                check(getattr(made, name).isfinite(), f"{name} in {dtype}")


def adversarial(step: int, size: int, rng: np.random.Generator) -> np.ndarray:
    """A batch (2, 2, size, size, 3) uint8 of frames that teach nothing."""
    frames = np.zeros((2, 2, size, size, 3), np.uint8)
    match step % 5:
        case 1:
            frames[:] = rng.integers(256, size=(2, 1, size, size, 3))  # still
        case 2:
            frames[:, 1, size // 2, size // 2] = 255  # one pixel
        case 3:
            frames[:] = 255
        case 4:
            frames[:, 0] = 255  # from white to black
    return frames


def check_training(steps: int, seed: int, size: int = 64) -> None:
    """A tiny renderer and a tokeniser of one code, half of the steps each."""
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    tiny = preset("tiny")
    config = replace(tiny.renderer, regions=3, affine_mode="svd")
    training = RendererTraining(steps=steps, batch=2, rate=1e-3, perceptual_width=8,
                                perceptual_scales=(0.5,))  # fmt: skip
    renderer = Renderer(config)
    objective = Objective(renderer, training, perceptual_loss(training))
    optimizer = adam(renderer, training)
    with torch.no_grad():  # a region that has collapsed into a corner
        renderer.estimator.regions.weight[0] *= 1e3
    for step in range(steps // 2):
        frames = torch.from_numpy(adversarial(step, size, rng))
        terms = objective(frames, torch.randn(2, 31))
        terms.pop("l1")
        loss = torch.stack(list(terms.values())).sum()
        check(loss.isfinite(), f"renderer's loss at step {step}")
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(renderer.parameters(), training.clip)
        optimizer.step()
    check_weights(renderer, "renderer")
    for name, values in hostile_training(steps - steps // 2):
        check(values.isfinite(), name)


def check_weights(model: torch.nn.Module, name: str) -> None:
    """Every number of a state dict is finite."""
    for key, values in model.state_dict().items():
        check(values.isfinite(), f"{name}: {key}")


def main() -> None:
    """Run the three parts, and tell how long each took."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--motions", type=int, default=10_000_000)
    parser.add_argument("--hardest", type=int, default=20_000)
    parser.add_argument("--steps", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    begin = time.monotonic()

    def tell(what: str) -> None:
        print(f"{what}: as they should be ({time.monotonic() - begin:.0f} s)", flush=True)

    try:
        regions = check_motions(options.motions, options.hardest, options.seed)
        tell(f"{options.motions} region motions")
        check_flow(regions, options.seed)
        tell(f"{len(regions.shift)} hardest through the flow predictor, float32 and bfloat16")
        check_training(options.steps, options.seed)
        tell(f"{options.steps} steps of training")
    except Fault as fault:
        sys.exit(f"check_numbers.py: {fault}")


if __name__ == "__main__":
    main()
