"""Import of released MRAA checkpoints: renderer and disentanglement network become a bundle."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from angie.bundle import Bundle
from angie.config import Preset, fitted
from data_prep.errors import BadInput
from data_prep.files import check_apart, sha256, whole_folder
from data_prep.progress import console
from data_prep.rates import IMAGE_SIZE
from data_prep.speaker.crop import FACE_DOWN, SIDE_IN_FACES
from mraa.released import load_released, read_checkpoint
from mraa.released_sizes import (
    UNSEEN,
    Parts,
    config_from_released,
    params_from_tensors,
    read_params,
    with_config,
)
from mraa.renderer import HourglassConfig, RendererConfig

TERMS = (
    "these weights are the work of their authors; their terms, not this project's, hold for them "
    "and for what is made with them"
)
"""Told to everyone who imports weights."""


def import_released(
    checkpoint: Path, output: Path, config: Path | None, preset: Preset, *, force: bool = False
) -> Bundle:
    """Write a speaker bundle whose renderer is a released checkpoint of MRAA.

    Args:
        checkpoint: the `.pth`, with or without the optimiser's state.
        output: folder of the bundle.
        config: MRAA's YAML for it; None reads the sizes off the tensors and takes MRAA's own
            values for what they cannot tell.
        preset: sizes of the stages that are still to be trained.
        force: replace an existing bundle.

    Raises:
        BadInput: not such a checkpoint, or a configuration that is not its own; nothing is left.
    """
    check_apart(output, [checkpoint, *([] if config is None else [config])])
    with whole_folder(output, mark="bundle.json", force=force) as folder:
        parts = read_checkpoint(checkpoint)
        sizes, trained_at = _sizes(checkpoint, parts, config)
        try:
            renderer, avd = load_released(parts, sizes)
        except BadInput as error:
            raise BadInput(f"{checkpoint}: {error}") from error
        settings = fitted(replace(preset, renderer=sizes))
        bundle = Bundle.create(folder, settings)
        bundle.manifest["crop"] = {"side_in_faces": SIDE_IN_FACES, "face_down": FACE_DOWN}
        origin = {"imported": Path(checkpoint).name, "imported_sha256": sha256(Path(checkpoint))}
        bundle.add("renderer", renderer.state_dict(), origin)
        if "avd_network" in parts:
            bundle.add("avd", avd.state_dict(), origin)
    for line in _notes(sizes, config, trained_at, with_avd="avd_network" in parts):
        console.print(line, soft_wrap=True, highlight=False, markup=False)
    return Bundle.open(output)


def _sizes(checkpoint: Path, parts: Parts, config: Path | None) -> tuple[RendererConfig, int]:
    """Sizes of the checkpoint, and the pixels of the images it was trained on, 0 if unknown."""
    try:
        params = params_from_tensors(parts)
    except BadInput as error:
        raise BadInput(f"{checkpoint}: {error}") from error
    if config is None:
        return config_from_released(params), 0
    given, trained_at = read_params(config)
    try:
        return config_from_released(with_config(params, given)), trained_at
    except BadInput as error:
        raise BadInput(f"{config}: {error}") from error


def _notes(
    sizes: RendererConfig, config: Path | None, trained_at: int, *, with_avd: bool
) -> Iterator[str]:
    """What the person should know of an import, a line each."""
    kind = sizes.background_kind
    yield (
        f"{sizes.regions} regions; estimator {_words(sizes.estimator)} at 1/"
        f"{round(1 / sizes.estimator_scale)}, flow {_words(sizes.flow)} at 1/"
        f"{round(1 / sizes.flow_scale)}, background {kind}, generator width "
        f"{sizes.generator.width} with {sizes.generator.down_blocks} down blocks and "
        f"{sizes.generator.bottleneck_blocks} residual blocks"
    )
    if config is None:
        values = ", ".join(f"{name} {value}" for name, (_, _, value) in UNSEEN.items())
        yield f"not told by the weights, so MRAA's own values: {values}; --config gives others"
    if trained_at not in (0, IMAGE_SIZE):
        yield f"trained on images of {trained_at} pixels; angie gives it {IMAGE_SIZE}"
    if not with_avd:
        yield "the checkpoint has no avd_network; --drive will use the relative mode"
    yield TERMS


def _words(sizes: HourglassConfig) -> str:
    return f"{sizes.width}/{sizes.blocks}/{sizes.max_width}"
