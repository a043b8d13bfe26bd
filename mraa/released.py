"""Released MRAA checkpoints: what they hold, and their tensor names in ours."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from data_prep.errors import BadInput
from mraa.avd import AvdNetwork
from mraa.pickled import load_pickled
from mraa.released_sizes import Parts
from mraa.renderer import Renderer, RendererConfig, make_avd

_PARTS = ("generator", "region_predictor", "bg_predictor", "avd_network")

_PREFIXES = {
    "generator": {
        "pixelwise_flow_predictor.hourglass.": "flow.hourglass.",
        "pixelwise_flow_predictor.mask.": "flow.mask.",
        "pixelwise_flow_predictor.occlusion.": "flow.occlusion.",
        "pixelwise_flow_predictor.down.weight": "flow.down.kernel",
        "bottleneck.r": "generator.bottleneck.",
        "": "generator.",
    },
    "region_predictor": {
        "predictor.": "estimator.hourglass.",
        "regions.": "estimator.regions.",
        "down.weight": "estimator.down.kernel",
    },
    "bg_predictor": {"down.weight": "background.down.kernel", "": "background."},
}


def our_name(part: str, name: str) -> str:
    """Name in `Renderer` of the tensor `name` of part `part` of a released checkpoint."""
    for prefix, ours in _PREFIXES[part].items():
        if name.startswith(prefix):
            return ours + name[len(prefix) :]
    raise BadInput(f"{part}.{name}: not a tensor of an MRAA checkpoint")


def read_checkpoint(path: Path) -> dict[str, dict[str, Tensor]]:
    """Read a `.pth` by weights-only loading; returns the state dict of each part in float32.

    Raises:
        BadInput: missing, not a checkpoint, truncated, or holding other things than tensors.
    """
    path = Path(path)
    content = load_pickled(path)
    if not isinstance(content, dict):
        raise BadInput(f"{path}: not an MRAA checkpoint, it is a {type(content).__name__}")
    missing = [part for part in _PARTS[:2] if part not in content]
    if missing:
        raise BadInput(f"{path}: not an MRAA checkpoint, it has no {' and no '.join(missing)}")
    try:
        return {part: _tensors(part, content[part]) for part in _PARTS if part in content}
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from error


def _tensors(part: str, state: Any) -> dict[str, Tensor]:
    """A state dict with plain names and whole, finite tensors."""
    if not isinstance(state, dict) or not all(isinstance(name, str) for name in state):
        raise BadInput(f"{part}: is not a table of tensors")
    if state and all(name.startswith("module.") for name in state):  # saved from several GPUs
        state = {name.removeprefix("module."): tensor for name, tensor in state.items()}
    tensors = {}
    for name, tensor in state.items():
        if not isinstance(tensor, Tensor) or tensor.layout != torch.strided or tensor.is_meta:
            raise BadInput(f"{part}: {name} is not a plain tensor")
        if tensor.untyped_storage().nbytes() < tensor.numel() * tensor.element_size():
            raise BadInput(f"{part}: {name} claims more values than it has")
        if tensor.is_floating_point():
            tensor = tensor.detach().float()
            if not tensor.isfinite().all():
                raise BadInput(f"{part}: {name} holds values that are not finite")
        elif tensor.dtype != torch.int64:
            raise BadInput(f"{part}: {name} is of type {tensor.dtype}, not of a float type")
        tensors[name] = tensor.clone(memory_format=torch.contiguous_format)
    return tensors


def load_released(parts: Parts, config: RendererConfig) -> tuple[Renderer, AvdNetwork]:
    """Renderer and disentanglement network with a released checkpoint's weights, in eval mode.

    Raises:
        BadInput: tensors that do not fit the configuration.
    """
    with torch.device("meta"):  # nothing is allocated for sizes that the tensors do not have
        renderer, avd = Renderer(config), make_avd(config)
    tensors = {
        our_name(part, name): tensor
        for part, state in parts.items()
        if part != "avd_network" and not (part == "bg_predictor" and not state)
        for name, tensor in state.items()
    }
    _fill(renderer, tensors)
    if "avd_network" in parts:
        _fill(avd, parts["avd_network"])
    else:
        avd = make_avd(config)
    return renderer.eval(), avd.eval()


def _fill(module: nn.Module, tensors: Mapping[str, Tensor]) -> None:
    """Give a module on the meta device its tensors.

    Raises:
        BadInput: what is missing, too many, or of another shape.
    """
    tensors = dict(tensors)
    wanted = module.state_dict()
    for name in wanted.keys() - tensors.keys():
        if name.endswith("num_batches_tracked"):  # checkpoints of old versions have none
            tensors[name] = torch.tensor(0)
    for name in sorted(wanted.keys() | tensors.keys()):
        if name not in tensors:
            raise BadInput(f"the checkpoint has no {name}; it is not whole, or not MRAA's")
        if name not in wanted:
            raise BadInput(f"{name} of the checkpoint has no place in MRAA's networks")
        found, place = tensors[name], wanted[name]
        if found.shape != place.shape or found.dtype != place.dtype:
            raise BadInput(
                f"{name} of the checkpoint is {list(found.shape)}, the sizes want "
                f"{list(place.shape)}"
            )
    module.load_state_dict(tensors, assign=True)
