"""Weights of one renderer as initial weights of another design.

    python scripts/refit_renderer.py GIVEN.safetensors OUT.safetensors [key=value ...]

The settings are those of the new renderer, over the `lite` preset. Tensors of the same name and
size are taken over, such as the region estimator and the flow predictor when the image generator
is another; the others are what a new renderer of seed 0 begins with.
"""

import argparse
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from angie.config import override, parse_overrides, preset
from data_prep.errors import BadInput, call_script
from data_prep.files import whole_file
from mraa.renderer import Renderer, RendererConfig


def refit(given: Path, config: RendererConfig) -> tuple[dict[str, Tensor], int]:
    """Weights for a renderer of `config`, and how many tensors of them are of the file `given`.

    Raises:
        BadInput: a file that is missing or no weights.
    """
    try:
        known = load_file(given)
    except (OSError, SafetensorError) as error:
        raise BadInput(f"{given}: not the weights of a renderer (safetensors)") from error
    torch.manual_seed(0)
    weights, taken = Renderer(config).state_dict(), 0
    for name, value in weights.items():
        if name in known and known[name].shape == value.shape:
            weights[name] = known[name].to(value.dtype)
            taken += 1
    return {name: value.contiguous() for name, value in weights.items()}, taken


def main() -> None:
    """Write the weights and say what was taken over."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("given", type=Path)
    parser.add_argument("output", type=Path)
    parser.add_argument("settings", nargs="*")
    asked = parser.parse_intermixed_args()
    settings = override(preset("lite"), parse_overrides(asked.settings))
    weights, taken = refit(asked.given, settings.renderer)
    with whole_file(asked.output, force=True) as part:
        save_file(weights, part)
    print(f"{asked.output}: {taken} of {len(weights)} tensors are those of {asked.given}")


if __name__ == "__main__":
    call_script(main)
