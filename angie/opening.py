"""The bundle that a training begins or goes on with.

What a training takes from other bundles: weights to begin with, and a teacher. Its data.
"""

import copy
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from torch import nn

from angie.bundle import TRAIN, Bundle
from angie.config import Preset, override, with_generator
from angie.generators import DEFAULT, family
from angie.generators.stages import plain, too_short
from angie.motion.keypoints import INDEX, KeypointDataset
from angie.motion.windows import WINDOW
from angie.parts import difference, stage_options
from data_prep.dataset import Dataset
from data_prep.errors import BadInput
from data_prep.files import check_output
from mraa.perceptual import load_vgg19
from mraa.regions import RegionEstimator
from mraa.renderer import Renderer, RendererConfig, make_avd
from mraa.training.objective import RendererTraining
from mraa.training.pairs import Share
from mraa.training.renderer import load_initial


def initial_weights(training: RendererTraining, config: RendererConfig) -> Path:
    """File of the weights that `training.initial` names, a bundle or a file.

    Raises:
        BadInput: no such bundle or file, or a renderer of other sizes; the first setting or
            tensor that differs is named.
    """
    path = Path(training.initial)
    if path.is_dir():
        bundle = Bundle.open(path)
        theirs, ours = (plain({"renderer": one}) for one in (bundle.preset.renderer, config))
        other = difference(theirs, ours)
        if other:
            raise BadInput(f"train_renderer.initial: {path} has {other}; give both the same")
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


def try_out(settings: Preset) -> None:
    """Build every part once: sizes that do not fit are told before anything is trained.

    Raises:
        BadInput: which part cannot be built.
    """
    parts: dict[str, Callable[[], nn.Module]] = {}
    if not settings.points:
        parts["renderer"] = lambda: Renderer(settings.renderer)
        parts["avd"] = lambda: make_avd(settings.renderer)
    for generator in settings.generators:
        own, prefix = settings.settings(generator), "" if generator == DEFAULT else f"{generator}."
        for stage in family(generator).wanted(own):
            if stage.build is not None:
                parts[f"{prefix}{stage.name}"] = partial(stage.build, own)
    for name, build in parts.items():
        try:
            model = build()
        except (ValueError, RuntimeError, ArithmeticError, AssertionError, LookupError) as error:
            reason = " ".join(str(error).split()) or type(error).__name__
            raise BadInput(f"{name}: no network can have these sizes ({reason})") from error
        if any(weights.numel() == 0 for weights in model.parameters()):
            raise BadInput(f"{name}: no network can have these sizes (a width of 0)")


def try_weights(settings: Preset) -> None:
    """Load once what the training of a renderer begins with or learns from.

    Raises:
        BadInput: weights that cannot be loaded.
    """
    training = settings.train_renderer
    if training.initial:
        initial_weights(training, settings.renderer)
    teacher_of(training, settings.renderer)
    if training.perceptual_weights:
        load_vgg19(Path(training.perceptual_weights))


def open_or_create(
    output: Path,
    preset: Preset | None,
    changes: dict[str, Any],
    generator: str | None,
    stage: str,
    resume: bool,
    force: bool,
    origin: Path | None = None,
) -> Bundle:
    """The bundle of a folder, made if need be, with the settings to train it with.

    `preset`: sizes of a new bundle; an existing one keeps its own. `generator`: family of the
    generator to train, which is added to a bundle without it. `stage`: what will be trained, "all"
    or a stage. `origin`: bundle whose renderer is trained on, see `trained_on`.

    Raises:
        BadInput: settings that cannot be, or a folder that cannot be used for this.
    """
    exists = (output / "bundle.json").exists()
    if not exists or (force and not resume):
        base = preset or Preset() if origin is None else trained_on(Bundle.open(origin))
        settings = override(_with(base, generator), changes)
        first = "motion" if settings.points else "renderer"
        if stage not in ("all", first):
            raise BadInput(f"{output}: has no {first} yet; run angie train --stage {first} first")
        try_out(settings)
        if not settings.points:
            try_weights(settings)
        if not exists and output.is_dir() and any(output.iterdir()):
            raise BadInput(f"{output}: holds other files; name a new folder for the bundle")
        check_output(output, force=output.is_dir())
        if exists:
            shutil.rmtree(output)
        bundle = Bundle.create(output, settings)
        if origin is not None and stage == "renderer":
            take_parts(bundle, Bundle.open(origin))
        return bundle
    if origin is not None:
        raise BadInput(f"{output}: exists already; leave --from out to go on with it")
    check_output(output / "bundle.json", force=True)
    if not resume and stage == "all":
        raise BadInput(f"{output}: exists already; go on with --resume or start anew with --force")
    bundle = Bundle.open(output)
    if preset is not None and preset.name != bundle.preset.name:
        raise BadInput(
            f"{output}: made with --preset {bundle.preset.name}; leave --preset out to go on"
        )
    changed = override(_with(bundle.preset, generator), changes)
    if changed != bundle.preset:
        check_used(bundle, changed, stage)
        try_out(changed)
        bundle.preset = changed
        drawn = "renderer" in bundle.parts and not bundle.has("renderer")
        if stage == "renderer" or (stage == "all" and drawn):
            try_weights(changed)
        bundle.write()
    return bundle


def check_used(bundle: Bundle, changed: Preset, stage: str) -> None:
    """Refuse settings of a training that is over: the bundle would tell of what was not done.

    Args:
        bundle: with the settings that its parts were trained with.
        changed: those that are asked for.
        stage: what will be trained, "all" or a stage.

    Raises:
        BadInput: which setting would not be used.
    """
    now = Bundle(bundle.folder, bundle.manifest, changed)
    again: set[str] = set()
    for part in now.parts:
        name, options = part.partition(".")[2] or part, stage_options(part)
        if stage == "all":
            anew = not now.has(part) or bool(again & set(now.upstream(part)))
        else:
            anew = options.endswith(f"--stage {stage}") or not now.has(part)
        if anew:
            again.add(part)
            continue
        before, after = (_training(part, name, preset) for preset in (bundle.preset, changed))
        other = difference(before, after)
        if other:
            raise BadInput(
                f"{bundle.folder}: {part} is trained already, with {other}; leave it out, "
                f"or train it again with {options}"
            )


def _training(part: str, stage: str, preset: Preset) -> dict[str, Any]:
    """The settings of the training of a part, as plain values under their section's name."""
    section = f"train_{stage}"
    owner = preset if part == stage else preset.settings(part.partition(".")[0])
    found = getattr(owner, section, None)
    return {} if found is None else plain({section: found})


def trained_on(origin: Bundle) -> Preset:
    """Settings by which a bundle's renderer is trained on, its regions frozen.

    Raises:
        BadInput: it draws nothing.
    """
    origin.path_of("renderer")
    training = replace(
        origin.preset.train_renderer,
        initial=str(origin.folder),
        freeze_estimator=True,
        warmup_steps=0,
    )
    return replace(origin.preset, train_renderer=training)


def take_parts(bundle: Bundle, origin: Bundle) -> None:
    """Copy the usable parts of a bundle with these settings into a new one, and whose motion it is.

    They stay usable with every renderer of the same regions.
    """
    for part in (name for name in origin.parts if origin.has(name)):
        path = origin.path_of(part)
        shutil.copy(path, bundle.folder / path.name)
        bundle.manifest["parts"][part] = copy.deepcopy(origin.manifest["parts"][part])
    bundle.manifest |= {key: origin.manifest[key] for key in ("speakers", "crop")}
    bundle.write()


def _with(preset: Preset, generator: str | None) -> Preset:
    """A preset that has the generator which is asked for, and some generator in any case."""
    return preset if generator is None and preset.generators else with_generator(preset, generator)


def open_data(folder: Path, output: Path) -> Dataset | KeypointDataset:
    """A dataset of videos, or one of joints if the folder holds `clips.csv`."""
    if (folder / INDEX).is_file():
        return KeypointDataset(folder, output / TRAIN / "features")
    return Dataset(folder)


def check_data(data: Dataset | KeypointDataset, speaker: str | None, stage: str) -> None:
    """Refuse data that cannot be trained on, before hours of the renderer's training.

    Raises:
        BadInput: no such speaker, no clips, or none as long as a window.
    """
    if speaker is not None and speaker not in data.speakers():
        raise BadInput(f"--speaker {speaker}: {data.path} has {', '.join(data.speakers())}")
    clips = data.clips("train")
    if not clips:
        raise BadInput(f"{data.path}: has no clips to train on; prepare more videos")
    lengths = [clip.n_frames for clip in clips if speaker in (None, clip.speaker)]
    if stage == "all" and max(lengths, default=0) < WINDOW:
        raise too_short(data.path)


def shares_of(
    data: Dataset | KeypointDataset, also: Sequence[tuple[Path, float]], stage: str
) -> list[Share]:
    """The further datasets of a renderer.

    Raises:
        BadInput: no use for them, no such dataset or clips, one named twice, or a bad weight.
    """
    if also and (isinstance(data, KeypointDataset) or stage not in ("all", "renderer")):
        raise BadInput("--also: only a renderer learns from several datasets")
    shares: list[Share] = []
    for place, weight in also:
        if not 0 < weight < float("inf"):
            raise BadInput(f"--also {place}:{weight:g}: the weight is a number above 0")
        share = Share(Dataset(place), weight)
        if not share.dataset.clips("train"):
            raise BadInput(f"{place}: has no clips to train on; prepare more videos")
        if share.dataset.digest in [data.digest, *(one.dataset.digest for one in shares)]:
            raise BadInput(f"--also {place}: is named twice; name each dataset once")
        shares.append(share)
    return shares
