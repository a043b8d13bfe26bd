"""Give a bundle another renderer of the same regions, so that its motion still fits.

    python scripts/replace_renderer.py BUNDLE WEIGHTS OUT [--report REPORT.json]

WEIGHTS is a safetensors file with its architecture in `renderer.json` beside it, as
`train_on_gpu.py` gives them back. Its region estimator must be that of BUNDLE, number for number:
motion is learnt on regions, so only then do the other parts stay true. OUT is BUNDLE with the new
renderer in half precision; what REPORT says of the renderer goes into it.
"""

import argparse
import dataclasses
import json
import shutil
from pathlib import Path

from safetensors.torch import load_file
from torch import Tensor

from angie.bundle import Bundle
from angie.config import stored
from angie.parts import halve
from data_prep.errors import BadInput, call_script
from data_prep.files import whole_folder
from mraa.renderer import RendererConfig


def architecture(weights: Path) -> RendererConfig:
    """The renderer's sizes, of `renderer.json` beside its weights.

    Raises:
        BadInput: it is missing, or holds something else.
    """
    path = weights.with_name("renderer.json")
    try:
        return stored({"renderer": json.loads(path.read_text())}).renderer
    except (OSError, ValueError) as error:
        raise BadInput(f"{path}: not the architecture of {weights.name} ({error})") from error


def same_regions(before: dict[str, Tensor], after: dict[str, Tensor], weights: Path) -> None:
    """Refuse weights whose region estimator is another.

    Raises:
        BadInput: a tensor of the region estimator differs.
    """
    for name in (n for n in before if n.startswith("estimator.")):
        if name not in after or not (before[name].float() == after[name].float()).all():
            raise BadInput(f"{weights}: another region estimator than the bundle's ({name})")


def main() -> None:
    """Write the new bundle."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    for name in ("bundle", "weights", "out"):
        parser.add_argument(name, type=Path)
    parser.add_argument("--report", type=Path, help="JSON: what to say of the renderer")
    given = parser.parse_args()
    old, after = Bundle.open(given.bundle), load_file(given.weights)
    same_regions(load_file(old.path_of("renderer")), after, given.weights)
    kept = load_file(old.path_of("renderer"))
    regions = {name: value for name, value in kept.items() if name.startswith("estimator.")}
    with whole_folder(given.out, mark="bundle.json", force=True) as part:
        for path in (p for p in given.bundle.iterdir() if p.is_file()):
            shutil.copy(path, part / path.name)
        new = Bundle.open(part)
        new.preset = dataclasses.replace(old.preset, renderer=architecture(given.weights))
        said = json.loads(given.report.read_text()) if given.report else {}
        new.add("renderer", halve(after) | regions, {"precision": "float16", **said})
        new.renderer(), new.generator()
    print(f"{given.out}: {sum(p.stat().st_size for p in given.out.iterdir()) / 1e6:.1f} MB")


if __name__ == "__main__":
    call_script(main)
