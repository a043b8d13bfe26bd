"""Whether a code moves different people alike: Figure 4 of the paper as a number.

    python scripts/check_codes_angie.py BUNDLE PHOTO PHOTO... [--pairs 12]

Frequent pairs of codes are drawn on every photo as `angie codebook` does. Of each the field of
displacement is taken where it moves most: how far the renderer's flow fetches every pixel from,
less the same of the still pose. What is printed is Pearson's correlation of two fields, both
coordinates of all pixels: of one pair of codes on two photos, and of two pairs of codes on one
photo; and how often the former is above the latter. Photos should be of different people.
"""

import argparse
import itertools
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from angie.bundle import Bundle
from angie.generators.angie.code_sheet import CodePair, choose_pairs, pair_motion, square_of
from angie.generators.angie.family import NAME, load_generator
from angie.generators.angie.generate import AngieGenerator
from data_prep.errors import BadInput, call_script
from mraa.draw import regions_of, source_pose
from mraa.renderer import Renderer, from_pixels


@torch.no_grad()
def field(renderer: Renderer, generator: AngieGenerator, picture: Any, codes: Any) -> NDArray:
    """Displacement (h, w, 2) by a pair of codes on a picture (1, 3, H, W), where it is largest."""
    pose = source_pose(renderer, picture)
    motion = pair_motion(generator, codes, pose)
    moved = (motion.shift - pose.shift).norm(dim=-1).mean(-1)
    peak = motion[int(moved.argmax()) : int(moved.argmax()) + 1]
    small, device = renderer.flow.down(picture), picture.device
    still = regions_of(renderer, pose, device)
    flows = [
        renderer.flow.from_small(small, still, regions_of(renderer, to, device)).flow[0]
        for to in (peak, pose)
    ]
    return (flows[0] - flows[1]).cpu().numpy()


def correlation(one: NDArray, other: NDArray) -> float:
    """Pearson's correlation of two fields, all numbers together; 0 where one does not move."""
    one, other = (values.ravel() - values.mean() for values in (one, other))
    size = np.sqrt((one**2).sum() * (other**2).sum())
    return float((one * other).sum() / size) if size > 0 else 0.0


def compare(fields: NDArray) -> dict[str, list[float]]:
    """Correlations of fields (photos, pairs, h, w, 2).

    Returns:
        `same code`, of one pair of codes on two photos; `same photo`, of two pairs on one photo.
    """
    photos, pairs = fields.shape[:2]
    alike = [
        correlation(fields[a, pair], fields[b, pair])
        for pair in range(pairs)
        for a, b in itertools.combinations(range(photos), 2)
    ]
    apart = [
        correlation(fields[photo, a], fields[photo, b])
        for photo in range(photos)
        for a, b in itertools.combinations(range(pairs), 2)
    ]
    return {"same code": alike, "same photo": apart}


def measure(
    renderer: Renderer, generator: AngieGenerator, pictures: list[Any], pairs: list[CodePair]
) -> dict[str, list[float]]:
    """`compare` of what pairs of codes do to pictures (1, 3, H, W)."""
    rows = [[field(renderer, generator, p, pair.codes) for pair in pairs] for p in pictures]
    return compare(np.array(rows))


def main() -> None:
    """Print both correlations."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bundle", type=Path)
    parser.add_argument("photos", type=Path, nargs="+")
    parser.add_argument("--pairs", type=int, default=12, help="of codes, at most")
    given = parser.parse_args()
    bundle = Bundle.open(given.bundle)
    generator, renderer = load_generator(bundle), bundle.renderer()
    if len(given.photos) < 2 or given.pairs < 2:
        raise BadInput("photos: two or more are compared, and two or more pairs of codes")
    if generator.gpt is None:
        raise BadInput(f"{given.bundle}: has no codes")
    pictures = []
    for path in given.photos:
        pictures.append(from_pixels(torch.from_numpy(square_of(path, None))[None]))
    pairs = choose_pairs(generator, bundle.report(f"{NAME}.vq").get("pairs", []), given.pairs)
    found = measure(renderer, generator, pictures, pairs)
    print(f"{len(pictures)} photos, {len(pairs)} pairs of codes")
    for name, values in found.items():
        low, high = np.quantile(values, [0.05, 0.95])
        print(
            f"{name}: correlation {np.mean(values):.3f} "
            f"(90 % between {low:.3f} and {high:.3f}, {len(values)} pairs of fields)"
        )
    alike, apart = (np.array(values) for values in found.values())
    above = (alike[:, None] > apart).mean()
    print(f"same code above same photo: {100 * above:.1f} % of the pairs of both kinds")


if __name__ == "__main__":
    call_script(main)
