"""Weights that a training elsewhere begins with and compares by, in half precision.

    python scripts/pack_weights.py PACKED [--bundle FOLDER]

Writes PACKED/initial.safetensors and .json (the renderer of a bundle, by default the one that
ships) and PACKED/natural.safetensors (the first blocks of EfficientNet-Lite0).
"""

import argparse
import dataclasses
import json
from pathlib import Path

from safetensors.torch import save_file

from angie.bundle import BUNDLE, Bundle
from angie.parts import halve
from data_prep.errors import call_script
from mraa.imagenet import load_imagenet


def main() -> None:
    """Write the three files."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("packed", type=Path)
    parser.add_argument("--bundle", type=Path, default=BUNDLE)
    given = parser.parse_args()
    renderer = Bundle.open(given.bundle).renderer()
    given.packed.mkdir(parents=True, exist_ok=True)
    save_file(halve(renderer.state_dict()), given.packed / "initial.safetensors")
    config = dataclasses.asdict(renderer.config)
    (given.packed / "initial.json").write_text(json.dumps(config, indent=1))
    save_file(halve(load_imagenet().state_dict()), given.packed / "natural.safetensors")


if __name__ == "__main__":
    call_script(main)
