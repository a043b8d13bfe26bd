"""How far reconstructed motion is from the truth, by the time since its first frame.

    python scripts/check_drift.py DATASET BUNDLE...

Every test clip of DATASET goes through each bundle's codes (the regression, where it has none) from
its true first pose on, as for the image scores of `angie evaluate`. What is printed is the mean
distance of the region centres from the true ones, in pixels of 256, in spans of frames: what is
summed up from changes drifts, absolute values do not. `held` is the first pose throughout.
"""

import argparse
from collections.abc import Callable
from pathlib import Path

from torch import Tensor

from angie.bundle import Bundle
from angie.evaluation.definitions import PIXEL
from angie.generators import family
from angie.motion.clips import MotionClip, read_clips
from data_prep.dataset import Dataset
from data_prep.errors import BadInput, call_script

SPANS = ((1, 48), (48, 96), (96, 192), (192, None))
"""First frame and end of the spans."""


def errors(clips: list[MotionClip], shift_of: Callable[[MotionClip], Tensor]) -> list[float]:
    """Mean distance in pixels of shifts (T, K, 2) from the true ones, for each span."""
    found: list[list[float]] = [[] for _ in SPANS]
    for clip in clips:
        apart = (shift_of(clip) - clip.motion.shift).norm(dim=-1).mean(-1) * PIXEL
        for span, values in zip(SPANS, found, strict=True):
            part = apart[span[0] : span[1]]
            if len(part):
                values.append(float(part.mean()))
    return [sum(values) / max(len(values), 1) for values in found]


def through(bundle: Bundle) -> Callable[[MotionClip], Tensor]:
    """Gives the shifts of a clip as its codes, or the regression, give them back."""
    generator, speakers = bundle.generator(), bundle.statistics().speakers
    reconstruct = family(bundle.chosen()).reconstruct
    if reconstruct is None:
        raise BadInput(f"{bundle.folder}: its generator has nothing to reconstruct motion by")

    def shifts(clip: MotionClip) -> Tensor:
        speaker = clip.speaker if clip.speaker in speakers else None
        return reconstruct(generator, clip, speaker).shift

    return shifts


def main() -> None:
    """Print a row for each bundle."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset", type=Path)
    parser.add_argument("bundles", type=Path, nargs="+")
    given = parser.parse_args()
    data, bundles = Dataset(given.dataset), [Bundle.open(path) for path in given.bundles]
    first = bundles[0]
    identity = first.motion_identity(data.digest)
    clips = read_clips(data, first.train / "motion", "test", identity)
    rows: dict[str, Callable[[MotionClip], Tensor]] = {"held": lambda c: c.motion.shift[:1]}
    rows |= {bundle.folder.name: through(bundle) for bundle in bundles}
    titles = [f"{start}-{'' if end is None else end - 1}" for start, end in SPANS]
    print(f"{'px by frame':16}" + "".join(f"{title:>10}" for title in titles))
    for name, shift_of in rows.items():
        print(f"{name:16}" + "".join(f"{value:10.2f}" for value in errors(clips, shift_of)))


if __name__ == "__main__":
    call_script(main)
