"""Parts of a speaker bundle: what each is trained on, with which settings, what is said of it."""

import dataclasses
import hashlib
import subprocess
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from safetensors import SafetensorError
from torch import Tensor, nn

from angie.config import Preset
from angie.generators import DEFAULT, family
from angie.generators.base import Family
from angie.generators.stages import Stage, plain
from data_prep.errors import BadInput
from data_prep.tensors import open_tensors

if TYPE_CHECKING:
    from angie.bundle import Bundle

UPSTREAM: dict[str, tuple[str, ...]] = {
    "renderer": (),
    "statistics": ("renderer",),
    "avd": ("renderer",),
}
"""Parts that all generators share, each with those that it is trained on."""

REGIONS = "regions"
"""Name in the manifest of the region estimator's hash: beside the renderer's own, and among what
parts are trained on. Up to format 2 these named the whole renderer."""

OPTIONAL = ("avd",)
"""Parts that a bundle may lack and still be whole."""

SHARED_STAGES = {"renderer": "renderer", "motion": "statistics", "avd": "avd"}
"""Part that each stage of training makes which is no generator's."""


def stage_of(part: str) -> tuple[Family, Stage]:
    """Family and stage that a part of a generator is of."""
    owner, _, name = part.partition(".")
    found = family(owner)
    return found, found.stage(name)


def upstream_of(part: str, preset: Preset) -> list[str]:
    """Parts that a part is trained on."""
    if part in UPSTREAM:
        return list(UPSTREAM[part])
    found, stage = stage_of(part)
    needs = (*stage.needs, *stage.more(preset.settings(found.name)))
    return [need if need in UPSTREAM else f"{found.name}.{need}" for need in needs]


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
        on_motion = ("regions", "avd_id_width", "avd_pose_width", "revert_axis_swap")
        own = on_motion if part == "avd" else [k for k in sizes if not k.startswith("avd_")]
        return plain({"renderer": {key: sizes[key] for key in own}})
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


def hash_of_regions(path: Path) -> str:
    """Hash of the region estimator in a file of a renderer's weights, whatever their precision.

    Raises:
        BadInput: not a safetensors file.
    """
    found = hashlib.sha256()
    try:
        with open_tensors(path, "numpy") as file:
            for name in sorted(key for key in file.keys() if key.startswith("estimator.")):
                value = file.get_tensor(name)
                kind = np.float32 if value.dtype.kind == "f" else np.int64
                found.update(f"{name} {value.shape}".encode())
                found.update(value.astype(kind).tobytes())
    except SafetensorError as error:
        raise BadInput(f"{path}: does not fit the sizes in bundle.json") from error
    return found.hexdigest()


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


def describe(bundle: "Bundle") -> str:
    """Several lines: preset, speakers, and each part with its state, data and score."""
    manifest = bundle.manifest
    points = bundle.preset.points
    what = f"{bundle.preset.renderer.regions} {'joints' if points else 'regions'}"
    size = "" if points else f"{manifest['size']}x{manifest['size']} "
    lines = [
        f"bundle      {bundle.folder}",
        f"format      {bundle.format}, made by angie {manifest['angie']}",
        f"preset      {manifest['preset']}: {what}, {size}at {manifest['fps']} fps",
        f"speakers    {', '.join(manifest['speakers']) or 'none yet'}",
    ]
    for name in bundle.generators:
        lines += [f"{label:<12}{text}" for label, text in _generator(bundle, name)]
    wide = max(map(len, bundle.parts), default=0) + 1
    lines += [f"{part:<{wide}}{_state(bundle, part)}" for part in bundle.parts]
    return "\n".join(lines)


def _generator(bundle: "Bundle", name: str) -> Iterator[tuple[str, str]]:
    """A generator of the bundle, and the styles that it tells apart."""
    try:
        found, settings = family(name), bundle.settings(name)
    except BadInput as error:
        yield "generator", f"{name}: {error}"
        return
    yield "generator", f"{name}: {found.title}"
    if bundle.has("statistics"):
        styles = found.styles(settings, bundle.statistics())
        if styles:
            yield "styles", f"{', '.join(styles)} (--style NAME)"


def _state(bundle: "Bundle", part: str) -> str:
    entry = bundle.manifest["parts"].get(part)
    if entry is None and part in OPTIONAL:
        return f"none (optional); angie train {stage_options(part)} makes it"
    if entry is None:
        return f"missing; angie train {stage_options(part)} makes it"
    try:
        bundle.path_of(part)
    except BadInput as error:
        return f"UNUSABLE: {error}"
    report: dict[str, Any] = entry["report"]
    words = [f"{entry['sha256'][:12]}"]
    if "dataset" in report:
        words.append(f"{report['minutes']} min in {report['clips']} clips of {report['dataset']}")
    for more in report.get("also", []):
        words.append(f"{more['minutes']} min of {more['dataset']}, weight {more['weight']:g}")
    if "imported" in report:
        words.append(f"imported from {report['imported']}, whose authors' terms hold for it")
    words += report.get("credits", [])
    if "perceptual" in report:
        words.append(f"perceptual loss {report['perceptual']}")
    if "reconstruction" in report:
        score = report["reconstruction"]
        words.append(
            f"held-out L1 {score['l1']:.4f} (copy {score['copy_l1']:.4f}), "
            f"PSNR {score['psnr']:.2f} dB (copy {score['copy_psnr']:.2f})"
        )
        if "ssim" in score:  # bundles from before it was measured lack it
            words.append(
                f"SSIM {score['ssim']:.4f} (copy {score['copy_ssim']:.4f}), "
                f"perceptual by {score['backend']} {score['perceptual']:.2f} "
                f"(copy {score['copy_perceptual']:.2f})"
            )
    if "recovery" in report:
        score = report["recovery"]
        words.append(
            "held-out pose of a body of other size: shift off by "
            f"{score['shift']:.4f} (as given {score['given_shift']:.4f}), affine by "
            f"{score['affine']:.4f} (as given {score['given_affine']:.4f})"
        )
    if part not in UPSTREAM:
        found, stage = stage_of(part)
        words += found.report(stage.name, report, bundle.settings(found.name))
    return "; ".join(words)
