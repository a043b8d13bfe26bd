"""What a training takes from other bundles: weights to begin with, and a teacher."""

import dataclasses
from pathlib import Path

from angie.bundle import Bundle
from data_prep.errors import BadInput
from mraa.initial import load_initial
from mraa.regions import RegionEstimator
from mraa.renderer import Renderer, RendererConfig
from mraa.renderer_training import RendererTraining


def initial_weights(training: RendererTraining, config: RendererConfig) -> Path:
    """File of the weights that `training.initial` names, a bundle or a file.

    Raises:
        BadInput: no such bundle or file, or a renderer of other sizes; the first setting or
            tensor that differs is named.
    """
    path = Path(training.initial)
    if path.is_dir():
        bundle = Bundle.open(path)
        difference = _difference(bundle.preset.renderer, config, "renderer.")
        if difference:
            raise BadInput(f"train_renderer.initial: {path} {difference}; give both the same")
        path = bundle.path_of("renderer")
    load_initial(Renderer(config), path)
    return path


def teacher_of(training: RendererTraining, config: RendererConfig) -> RegionEstimator | None:
    """The frozen region estimator of the bundle that `training.teacher` names, if any.

    Raises:
        BadInput: no such bundle, or another number of regions.
    """
    if not training.teacher:
        return None
    renderer = Bundle.open(Path(training.teacher)).renderer()
    if renderer.config.regions != config.regions:
        raise BadInput(
            f"train_renderer.teacher: {training.teacher} has {renderer.config.regions} regions, "
            f"this renderer {config.regions}; set renderer.regions={renderer.config.regions}"
        )
    return renderer.estimator


def _difference(there: object, here: object, prefix: str) -> str:
    """The first setting in which two configurations differ, in words; "" for none."""
    for entry in dataclasses.fields(here):  # type: ignore[arg-type]
        a, b = getattr(there, entry.name), getattr(here, entry.name)
        if dataclasses.is_dataclass(b):
            inner = _difference(a, b, f"{prefix}{entry.name}.")
            if inner:
                return inner
        elif a != b:
            return f"has {prefix}{entry.name}={a}, this training {b}"
    return ""
