"""Released MRAA checkpoints: their tensor names and settings in ours."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from data_prep.errors import BadInput
from mraa.avd import AvdNetwork
from mraa.renderer import GeneratorConfig, HourglassConfig, Renderer, RendererConfig, make_avd

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
    "bg_predictor": {"": "background."},
}


def our_name(part: str, name: str) -> str:
    """Name in `Renderer` of the tensor `name` of part `part` of a released checkpoint."""
    for prefix, ours in _PREFIXES[part].items():
        if name.startswith(prefix):
            return ours + name[len(prefix) :]
    raise BadInput(f"{part}.{name}: not a tensor of an MRAA checkpoint")


def config_from_released(params: Mapping[str, Any]) -> RendererConfig:
    """Renderer sizes from the `model_params` of a released configuration.

    Released weights were trained with `align_corners=False` and no covariance floor.
    """
    estimator, background = params["region_predictor_params"], params["bg_predictor_params"]
    generator = params["generator_params"]
    flow = generator["pixelwise_flow_predictor_params"]
    avd = params.get("avd_network_params", {})
    return RendererConfig(
        regions=params["num_regions"],
        estimator=_hourglass(estimator),
        estimator_scale=estimator.get("scale_factor", 1),
        temperature=estimator["temperature"],
        heatmap_padding=estimator.get("pad", 0),
        background=_hourglass(background),
        background_kind=background.get("bg_type", "zero"),
        flow=_hourglass(flow),
        flow_scale=flow.get("scale_factor", 1),
        generator=GeneratorConfig(
            width=generator["block_expansion"],
            max_width=generator["max_features"],
            down_blocks=generator["num_down_blocks"],
            bottleneck_blocks=generator["num_bottleneck_blocks"],
        ),
        skips=generator.get("skips", False),
        avd_id_width=avd.get("id_bottle_size", 64),
        avd_pose_width=avd.get("pose_bottle_size", 64),
        covariance_floor=0.0,
        align_corners=False,
        revert_axis_swap=params.get("revert_axis_swap", True),
    )


def _hourglass(params: Mapping[str, Any]) -> HourglassConfig:
    return HourglassConfig(params["block_expansion"], params["num_blocks"], params["max_features"])


def read_checkpoint(path: Path) -> dict[str, dict[str, Tensor]]:
    """Read a `.pth` by weights-only loading; returns the state dict of each part.

    Raises:
        BadInput: missing, not a checkpoint, truncated, or holding other things than tensors.
    """
    path = Path(path)
    if not path.is_file():
        raise BadInput(f"{path}: no such file")
    try:
        parts = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises many kinds for a damaged or hostile file
        raise BadInput(f"{path}: not a readable checkpoint ({type(error).__name__})") from error
    missing = [part for part in _PARTS[:2] if part not in parts]
    if missing:
        raise BadInput(f"{path}: not an MRAA checkpoint, it has no {' and no '.join(missing)}")
    return {part: parts[part] for part in _PARTS if part in parts}


def load_released(
    parts: Mapping[str, Mapping[str, Tensor]], config: RendererConfig
) -> tuple[Renderer, AvdNetwork]:
    """Renderer and disentanglement network with a released checkpoint's weights, in eval mode.

    Raises:
        BadInput: tensors that do not fit the configuration.
    """
    renderer, avd = Renderer(config), make_avd(config)
    tensors = {
        our_name(part, name): tensor
        for part, state in parts.items()
        if part != "avd_network"
        for name, tensor in state.items()
    }
    try:
        renderer.load_state_dict(tensors)
        if "avd_network" in parts:
            avd.load_state_dict(dict(parts["avd_network"]))
    except RuntimeError as error:
        raise BadInput(f"the checkpoint does not fit its configuration: {error}") from error
    return renderer.eval(), avd.eval()
