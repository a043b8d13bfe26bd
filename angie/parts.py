"""Parts of a speaker bundle: what each is trained on, with which settings, and their weights."""

import dataclasses
import subprocess
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import torch
from torch import Tensor, nn

from angie.config import Preset
from angie.generators import DEFAULT, family
from angie.generators.base import Family
from angie.generators.stages import Stage, plain

UPSTREAM: dict[str, tuple[str, ...]] = {
    "renderer": (),
    "statistics": ("renderer",),
    "avd": ("renderer",),
}
"""Parts that all generators share, each with those that it is trained on."""

OPTIONAL = ("avd",)
"""Parts that a bundle may lack and still be whole."""

SHARED_STAGES = {"renderer": "renderer", "motion": "statistics", "avd": "avd"}
"""Part that each stage of training makes which is no generator's."""


def stage_of(part: str) -> tuple[Family, Stage]:
    """Family and stage that a part of a generator is of."""
    owner, _, name = part.partition(".")
    found = family(owner)
    return found, found.stage(name)


def upstream_of(part: str) -> list[str]:
    """Parts that a part is trained on."""
    if part in UPSTREAM:
        return list(UPSTREAM[part])
    found, stage = stage_of(part)
    return [need if need in UPSTREAM else f"{found.name}.{need}" for need in stage.needs]


def stage_options(part: str) -> str:
    """Options of `angie train` that make a part."""
    for stage, shared in SHARED_STAGES.items():
        if part == shared:
            return f"--stage {stage}"
    owner, _, name = part.partition(".")
    option = "" if owner == DEFAULT else f"--generator {owner} "
    return f"{option}--stage {name}"


def sizes_of(part: str, preset: Preset) -> dict[str, Any]:
    """The settings that a part depends on, as plain values."""
    if part == "statistics":
        return {}
    if part in UPSTREAM:
        sizes = dataclasses.asdict(preset.renderer)
        kept = {k: v for k, v in sizes.items() if part == "avd" or not k.startswith("avd_")}
        return plain({"renderer": kept})
    found, stage = stage_of(part)
    return plain(stage.sizes(preset.settings(found.name)))


def changed(part: str, trained: Mapping[str, Any], preset: Preset) -> str:
    """The first setting that a part was trained with at another value, in words, or "".

    A setting that came later than the part is taken at its default.
    """
    usual = Preset()
    if part not in UPSTREAM:
        found, _ = stage_of(part)
        usual = Preset(generators={found.name: found.settings()})
    return difference(trained, sizes_of(part, preset), sizes_of(part, usual))


def difference(
    trained: Mapping[str, Any],
    now: Mapping[str, Any],
    usual: Mapping[str, Any] = MappingProxyType({}),
    prefix: str = "",
) -> str:
    """The first setting that differs, in words, or ""."""
    for key, value in now.items():
        default = usual.get(key)
        before = trained.get(key, default)
        if isinstance(value, Mapping) and isinstance(before, Mapping):
            inner = difference(before, value, default or {}, f"{prefix}{key}.")
            if inner:
                return inner
        elif before != value:
            return f"{prefix}{key}={before}, not {value}"
    return ""


def load_weights(model: nn.Module, tensors: Mapping[str, Tensor]) -> None:
    """Load weights that may be stored in half precision into a float32 model."""
    wanted = model.state_dict()
    model.load_state_dict(
        {k: v.to(wanted[k].dtype) if k in wanted else v for k, v in tensors.items()}
    )


def halve(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Float tensors in half precision, for bundles that have to be small."""
    return {
        k: v.half() if v.dtype == torch.float32 and v.ndim > 1 else v for k, v in tensors.items()
    }


def source_commit() -> str:
    """Commit of the source tree that runs, or "" for an installed package."""
    root = Path(__file__).resolve().parents[1]
    if not (root / ".git").exists():
        return ""
    command = ["git", "-C", str(root), "rev-parse", "HEAD"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()
    except OSError:  # git is not installed
        return ""
