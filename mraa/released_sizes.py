"""Sizes of a released MRAA checkpoint: from its configuration, or from its tensors alone."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml
from torch import Tensor

from data_prep.errors import BadInput
from data_prep.media.container import check_file
from mraa.flow import PARAMETERS
from mraa.renderer import GeneratorConfig, HourglassConfig, RendererConfig

Parts = Mapping[str, Mapping[str, Tensor]]
"""State dicts of `generator`, `region_predictor`, `bg_predictor` and `avd_network`."""

UNSEEN = {
    "temperature": ("region_predictor_params", "temperature", 0.1),
    "pad": ("region_predictor_params", "pad", 0),
    "skips": ("generator_params", "skips", True),
    "revert_axis_swap": (None, "revert_axis_swap", True),
}
"""Settings that leave no trace in the tensors: section, key, and value in MRAA's configurations."""

_FLOW = ("generator_params", "pixelwise_flow_predictor_params")
_NEEDED: dict[tuple[tuple[str, ...], str], bool] = {
    ((), "estimate_affine"): True,
    (("region_predictor_params",), "pca_based"): True,
    (_FLOW, "use_deformed_source"): True,
    (_FLOW, "use_covar_heatmap"): True,
    (_FLOW, "estimate_occlusion_map"): True,
}
"""Settings that every released configuration has and that this renderer is built for."""


def config_from_released(params: Mapping[str, Any]) -> RendererConfig:
    """Renderer sizes from the `model_params` of a released configuration.

    Released weights were trained with `align_corners=False`, with no covariance floor and with
    the signs of LAPACK's SVD, which the disentanglement network reads.

    Raises:
        BadInput: settings are missing or of another kind.
    """
    try:
        return _config(params)
    except KeyError as error:
        raise BadInput(f"the configuration has no {error.args[0]}") from error
    except (TypeError, ValueError, AttributeError) as error:
        raise BadInput(f"the configuration cannot be used ({error})") from error


def _config(params: Mapping[str, Any]) -> RendererConfig:
    estimator, background = params["region_predictor_params"], params["bg_predictor_params"]
    generator = params["generator_params"]
    flow = generator["pixelwise_flow_predictor_params"]
    avd = params.get("avd_network_params", {})
    return RendererConfig(
        regions=params["num_regions"],
        estimator=_hourglass(estimator),
        estimator_scale=float(estimator.get("scale_factor", 1)),
        temperature=float(estimator["temperature"]),
        heatmap_padding=estimator.get("pad", 0),
        background=_hourglass(background),
        background_kind=background.get("bg_type", "zero"),
        background_scale=float(background.get("scale_factor", 1)),
        flow=_hourglass(flow),
        flow_scale=float(flow.get("scale_factor", 1)),
        generator=GeneratorConfig(
            width=generator["block_expansion"],
            max_width=generator["max_features"],
            down_blocks=generator["num_down_blocks"],
            bottleneck_blocks=generator["num_bottleneck_blocks"],
        ),
        skips=generator.get("skips", False),
        avd_id_width=avd.get("id_bottle_size", 64),
        avd_pose_width=avd.get("pose_bottle_size", 64),
        affine_mode="lapack",
        covariance_floor=0.0,
        align_corners=False,
        revert_axis_swap=params.get("revert_axis_swap", True),
    )


def _hourglass(params: Mapping[str, Any]) -> HourglassConfig:
    return HourglassConfig(params["block_expansion"], params["num_blocks"], params["max_features"])


def read_params(path: Path) -> tuple[dict[str, Any], int]:
    """The `model_params` of a configuration file, and the image size that it names (0 for none).

    Args:
        path: YAML (or JSON) of MRAA: the whole configuration, or `model_params` alone.

    Raises:
        BadInput: missing, unreadable, or another kind of configuration.
    """
    check_file(path)
    try:
        content = yaml.safe_load(Path(path).read_bytes())
    except (OSError, yaml.YAMLError, ValueError, RecursionError) as error:
        reason = getattr(error, "strerror", None) or "it is no YAML"
        raise BadInput(f"{path}: cannot be read ({reason})") from error
    params = content.get("model_params", content) if isinstance(content, dict) else None
    if not isinstance(params, dict) or "region_predictor_params" not in params:
        raise BadInput(f"{path}: not a configuration of MRAA, it has no region_predictor_params")
    for (names, key), wanted in _NEEDED.items():
        place: Any = params
        for name in names:
            place = place.get(name) if isinstance(place, dict) else None
        if not isinstance(place, dict):
            raise BadInput(f"{path}: not a configuration of MRAA, it has no {names[-1]}")
        if place.get(key, wanted) is not wanted:
            raise BadInput(f"{path}: {key} {place[key]} is not supported, only {wanted}")
    data = content.get("dataset_params")
    shape = data.get("frame_shape") if isinstance(data, dict) else None
    size = shape[0] if isinstance(shape, list) and shape and isinstance(shape[0], int) else 0
    return params, size


def params_from_tensors(parts: Parts) -> dict[str, Any]:
    """The `model_params` that the shapes of a checkpoint's tensors tell, and MRAA's `UNSEEN`.

    Raises:
        BadInput: tensors are missing, or are not those of such networks.
    """
    generator = _Shapes("generator", parts)
    estimator = _Shapes("region_predictor", parts)
    flow = "pixelwise_flow_predictor."
    regions, channels = estimator("regions.weight")[:2]
    if generator(flow + "mask.weight")[0] != regions + 1:
        raise BadInput("generator: not of the same number of regions as region_predictor")
    if generator(flow + "hourglass.encoder.down_blocks.0.conv.weight")[1] != 4 * (regions + 1):
        raise BadInput("generator: not MRAA's flow predictor with heatmaps and deformed sources")
    generator(flow + "occlusion.weight")
    if channels != estimator.hourglass("predictor.")["block_expansion"] + 3:
        raise BadInput("region_predictor: not made for images of three channels")
    downs = generator.widths("down_blocks.")
    first = generator("first.conv.weight")[0]
    params: dict[str, Any] = {
        "num_regions": regions,
        "region_predictor_params": {
            **estimator.hourglass("predictor."),
            "scale_factor": estimator.scale("down.weight"),
        },
        "bg_predictor_params": _background(parts),
        "generator_params": {
            "block_expansion": first,
            "max_features": max([first, *downs]),
            "num_down_blocks": len(downs),
            "num_bottleneck_blocks": generator.count("bottleneck.r{}.conv1.weight"),
            "pixelwise_flow_predictor_params": {
                **generator.hourglass(flow + "hourglass."),
                "scale_factor": generator.scale(flow + "down.weight"),
            },
        },
    }
    if "avd_network" in parts:
        avd = _Shapes("avd_network", parts)
        params["avd_network_params"] = {
            "id_bottle_size": avd("id_encoder.9.weight")[0],
            "pose_bottle_size": avd("pose_encoder.9.weight")[0],
        }
    for section, key, value in UNSEEN.values():
        (params if section is None else params[section])[key] = value
    return params


def _background(parts: Parts) -> dict[str, Any]:
    if not parts.get("bg_predictor"):
        return {"block_expansion": 32, "max_features": 1024, "num_blocks": 5, "bg_type": "zero"}
    shapes = _Shapes("bg_predictor", parts)
    widths = shapes.widths("encoder.down_blocks.")
    numbers = shapes("fc.weight")[0]
    kinds = {count: kind for kind, count in PARAMETERS.items()}
    if numbers not in kinds or not widths:
        raise BadInput("bg_predictor: no background motion that MRAA knows")
    return {
        "block_expansion": widths[0] // 2,
        "max_features": max(widths),
        "num_blocks": len(widths),
        "bg_type": kinds[numbers],
        "scale_factor": shapes.scale("down.weight"),
    }


class _Shapes:
    """Shapes of one part's tensors, by name."""

    def __init__(self, part: str, parts: Parts) -> None:
        self.part, self.tensors = part, parts[part]

    def __call__(self, name: str) -> list[int]:
        if name not in self.tensors:
            raise BadInput(f"{self.part}: has no {name}; not MRAA's, or not whole")
        shape = list(self.tensors[name].shape)
        if len(shape) not in (2, 4) or min(shape) < 1:
            raise BadInput(f"{self.part}: {name} has the shape {shape}; not MRAA's")
        return shape

    def count(self, pattern: str) -> int:
        number = 0
        while pattern.format(number) in self.tensors:
            number += 1
        return number

    def widths(self, prefix: str) -> list[int]:
        """Channels that each down block gives."""
        pattern = prefix + "{}.conv.weight"
        return [self(pattern.format(i))[0] for i in range(self.count(pattern))]

    def hourglass(self, prefix: str) -> dict[str, int]:
        widths = self.widths(prefix + "encoder.down_blocks.")
        last = self(f"{prefix}decoder.up_blocks.{max(len(widths) - 1, 0)}.conv.weight")
        return {
            "block_expansion": last[0],
            "max_features": max([last[0], *widths]),
            "num_blocks": len(widths),
        }

    def scale(self, name: str) -> float:
        """Sub-sampling whose low-pass kernel has this size; 1 where there is none."""
        if name not in self.tensors:
            return 1
        size = self(name)[-1]
        steps, rest = divmod(size - 1, 4)  # sigma (n - 1) / 2 gives 4 (n - 1) + 1 taps
        if rest or not steps:
            raise BadInput(f"{self.part}: {name} is not a low-pass kernel of MRAA ({size} taps)")
        return 1 / (steps + 1)


def with_config(found: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """What the tensors tell, completed by a configuration for what they cannot.

    Args:
        found: as `params_from_tensors` gives it.
        given: `model_params` of a configuration.

    Raises:
        BadInput: the two contradict one another.
    """
    unseen = {key for _, key, _ in UNSEEN.values()}
    result: dict[str, Any] = {}
    for key, value in found.items():
        other = given.get(key, value)
        if isinstance(value, Mapping):
            if not isinstance(other, Mapping):
                raise BadInput(f"the configuration's {key} is not a section")
            result[key] = with_config(value, other)
        elif key in unseen:
            if type(other) is not type(value) and not (
                isinstance(value, float) and isinstance(other, int)
            ):
                raise BadInput(f"the configuration's {key} {other} is not of the right kind")
            result[key] = other
        elif key == "max_features" or other == value:  # a bound that may lie above what is there
            result[key] = value
        elif isinstance(value, float) and isinstance(other, float) and abs(other - value) < 1e-3:
            result[key] = value  # 0.33 for a third
        else:
            raise BadInput(f"the configuration says {key} {other}, the tensors {value}")
    return result
