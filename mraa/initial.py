"""Weights to begin with: of a file, or of a training on smaller images."""

import copy
import dataclasses
from pathlib import Path

from safetensors import SafetensorError
from safetensors.torch import load_file

from data_prep.errors import BadInput
from data_prep.rates import IMAGE_SIZE
from mraa.blocks import AntiAliasDown
from mraa.regions import RegionEstimator
from mraa.renderer import Renderer, RendererConfig


def reduced(config: RendererConfig, size: int) -> RendererConfig:
    """The renderer for images of `size` pixels whose hourglasses work at the same resolution."""
    factor = IMAGE_SIZE / size
    scales = ("estimator_scale", "flow_scale", "background_scale")
    changed = {name: min(1.0, getattr(config, name) * factor) for name in scales}
    return dataclasses.replace(config, **changed)


def load_initial(renderer: Renderer, path: Path) -> None:
    """Load weights from a safetensors file.

    Raises:
        BadInput: missing, unreadable, or of other sizes.
    """
    try:
        given = load_file(path)
    except (OSError, SafetensorError) as error:
        reason = str(error).splitlines()[0]
        raise BadInput(f"{path}: not the weights of a renderer ({reason})") from error
    wanted = renderer.state_dict()
    for name, value in wanted.items():
        if name not in given:
            raise BadInput(f"{path}: not the weights of such a renderer (it has no {name})")
        if given[name].shape != value.shape:
            there, here = ("x".join(map(str, x.shape)) for x in (given[name], value))
            raise BadInput(f"{path}: {name} is {there} there and {here} here; give the same sizes")
    if len(given) > len(wanted):
        other = min(given.keys() - wanted.keys())
        raise BadInput(f"{path}: not the weights of such a renderer ({other} has no place)")
    renderer.load_state_dict({k: v.to(wanted[k].dtype) for k, v in given.items()})


def take_weights(renderer: Renderer, taught: Renderer) -> None:
    """Copy all weights but the low-pass kernels, which depend on the image size."""
    kept = {k: v for k, v in renderer.state_dict().items() if k.endswith("down.kernel")}
    given = {k: v for k, v in taught.state_dict().items() if not k.endswith("down.kernel")}
    renderer.load_state_dict({**kept, **given})


def reduced_estimator(estimator: RegionEstimator, size: int) -> RegionEstimator:
    """The same estimator for images of `size` pixels; its hourglass sees them as before."""
    smaller = copy.deepcopy(estimator)
    smaller.down = AntiAliasDown(3, min(1.0, IMAGE_SIZE / size / estimator.down.step))
    return smaller
