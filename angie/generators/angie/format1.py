"""Bundles of format 1, which knew ANGIE alone: what their parts and settings are called now."""

from typing import Any

PARTS = {"vq": "angie.vq", "gpt": "angie.gpt", "refiner": "angie.refiner"}

SECTIONS = ("vq", "gpt", "refiner", "generation", "train_vq", "train_gpt", "train_refiner")

RENAMED = {("train_vq", "summed"): "path_loss", ("train_vq", "summed_norm"): "path_loss_norm"}

REMOVED = {
    ("refiner", "mfcc_encoder"): "linear",
    ("train_vq", "still_share"): 1.0,
    ("train_refiner", "covariance"): 0.0,
    ("generation", "smooth"): 0.0,
}
"""Settings that are gone, with the one value at which nothing is lost."""


def upgrade(manifest: dict[str, Any]) -> dict[str, Any]:
    """The manifest of format 2 of one of format 1; the files keep their names.

    The settings of its parts are None: those that the manifest states.

    Raises:
        ValueError: a setting that is gone, at another value than its default.
    """
    config = dict(manifest["config"])
    own = {name: _section(name, config.pop(name)) for name in SECTIONS if name in config}
    parts = {}
    for name, entry in manifest["parts"].items():
        report = dict(entry["report"])
        if "hearing" in report:
            report["audio_sensitivity"] = report.pop("hearing")
        parts[PARTS.get(name, name)] = {
            "file": entry["file"],
            "sha256": entry["sha256"],
            "upstream": {PARTS.get(k, k): value for k, value in entry["upstream"].items()},
            "settings": None,
            "report": report,
        }
    return {**manifest, "format": 2, "config": {**config, "generators": {"angie": own}},
            "parts": parts}  # fmt: skip


def _section(name: str, values: dict[str, Any]) -> dict[str, Any]:
    kept = {}
    for key, value in values.items():
        if (name, key) not in REMOVED:
            kept[RENAMED.get((name, key), key)] = value
        elif value != REMOVED[name, key]:
            raise ValueError(f"{name}.{key}={value} is no longer supported; use angie 0.1")
    return kept
