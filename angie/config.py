"""Presets `paper`, `lite` and `tiny`: every size and every number of training in one place."""

import dataclasses
import difflib
import math
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import yaml

from angie.generators.angie.generate import GenerationConfig
from angie.generators.angie.gpt import GPTConfig
from angie.generators.angie.refiner import RefinerConfig
from angie.generators.angie.sampling import Sampling, Window
from angie.generators.angie.tokenizer import VQConfig
from angie.generators.angie.train_gpt import GPTTraining
from angie.generators.angie.train_refiner import RefinerTraining
from angie.generators.angie.train_vq import VQTraining
from angie.motion.windows import WINDOW_TOKENS
from data_prep.errors import BadInput
from data_prep.speech.features import ONSET_SIZE
from mraa.renderer import GeneratorConfig, HourglassConfig, RendererConfig
from mraa.training.avd import AvdTraining
from mraa.training.checkpoint import Schedule
from mraa.training.objective import RendererTraining
from mraa.training.pairs import Augmentation

T = TypeVar("T")


@dataclass(frozen=True)
class Preset:
    """Sizes and training of every part; the defaults are the papers'.

    Attributes:
        name: of the preset.
        points: joints in place of regions: no renderer, and of the two streams of motion only
            that of the shift.
        renderer: sizes; its `regions` are those of every part.
        vq: sizes.
        gpt: sizes.
        refiner: sizes.
        generation: how motion is generated.
        train_renderer: how the renderer is trained.
        train_vq: how the VQ motion extractor is trained.
        train_gpt: how the GPT is trained.
        train_refiner: how the refiner is trained.
    """

    name: str = "paper"
    points: bool = False
    renderer: RendererConfig = field(default_factory=RendererConfig)
    vq: VQConfig = field(default_factory=VQConfig)
    gpt: GPTConfig = field(default_factory=GPTConfig)
    refiner: RefinerConfig = field(default_factory=RefinerConfig)
    generation: GenerationConfig = field(
        default_factory=lambda: GenerationConfig(sampling=Sampling(method="greedy"))
    )
    train_renderer: RendererTraining = field(default_factory=RendererTraining)
    train_vq: VQTraining = field(default_factory=VQTraining)
    train_gpt: GPTTraining = field(default_factory=GPTTraining)
    train_refiner: RefinerTraining = field(default_factory=RefinerTraining)
    train_avd: AvdTraining = field(default_factory=AvdTraining)

    def __post_init__(self) -> None:
        counts = {self.renderer.regions, self.vq.regions, self.refiner.regions}
        if len(counts) > 1 or self.vq.codes != self.gpt.codes:
            raise BadInput("the parts disagree: regions or codes are set for one part alone")
        streams = {self.vq.streams, self.gpt.streams, self.refiner.streams}
        if streams != {1 if self.points else 2}:
            raise BadInput("the parts disagree: streams is 1 for points, else 2, in every part")
        if (self.gpt.onset, self.gpt.block) != (ONSET_SIZE, WINDOW_TOKENS - 1):
            raise BadInput(
                f"gpt: onset is {ONSET_SIZE} and block {WINDOW_TOKENS - 1}, as in all windows"
            )


def _lite() -> Preset:
    """Renders in real time on a laptop CPU: slim generator, the photo itself warped."""
    return Preset(
        name="lite",
        renderer=RendererConfig(
            estimator=HourglassConfig(16, 5, 128),
            background=HourglassConfig(16, 4, 64),
            background_scale=0.25,
            flow=HourglassConfig(32, 5, 128),
            generator=GeneratorConfig("lite", width=128, bottleneck_blocks=6),
            affine_mode="sym",
        ),
        vq=VQConfig(width=64, code_width=64, restart_below=0.1, context="clip"),
        gpt=GPTConfig(width=128, heads=4, layers=4, dropout=0.3),
        refiner=RefinerConfig(sound=96, motion=64, hidden=128),
        generation=GenerationConfig(
            bounding="auto",
            decode="auto",
            blend="hann",
            sampling=Sampling(method="topk", repeat_guard=True, calm=True),
        ),
        train_renderer=RendererTraining(
            batch=8,
            repeats=150,
            perceptual_width=16,
            perceptual_scales=(0.5, 0.25, 0.125),
            equivariance_shift=2.0,
            equivariance_affine=1.0,
            augmentation=Augmentation(zoom=0.15),
            warmup_steps=3000,
        ),
        train_vq=VQTraining(
            schedule=Schedule(rate=1e-3, milestones=(375, 460), most_steps=6000),
            stride=5,
            summed=0.3,
            summed_norm="square",
            warmup=0.15,
        ),
        train_gpt=GPTTraining(
            schedule=Schedule(rate=1e-3, milestones=(400,), most_steps=1800),
            stride=8,
            grids=8,
            checks=30,
        ),
        train_refiner=RefinerTraining(
            schedule=Schedule(
                rate=2e-3, betas=(0.9, 0.999), epochs=100, milestones=(80,), most_steps=3000
            ),
            stride=16,
            velocity=20.0,
        ),
        train_avd=AvdTraining(
            schedule=Schedule(rate=1e-3, batch=256, epochs=30, milestones=(20, 25), most_steps=4000)
        ),
    )


def _tiny() -> Preset:
    """For tests and first tries: every stage trains in seconds to a few minutes."""
    return Preset(
        name="tiny",
        renderer=RendererConfig(
            regions=10,
            estimator=HourglassConfig(8, 4, 64),
            background=HourglassConfig(8, 4, 32),
            background_scale=0.25,
            flow=HourglassConfig(16, 4, 64),
            generator=GeneratorConfig("lite", width=32, bottleneck_blocks=2),
            affine_mode="sym",
        ),
        vq=VQConfig(regions=10, width=32, code_width=32),
        gpt=GPTConfig(width=64, heads=4, layers=2),
        refiner=RefinerConfig(regions=10, sound=32, motion=32, hidden=32, layers=1),
        generation=GenerationConfig(
            bounding="auto",
            decode="auto",
            window=Window("hop"),
            sampling=Sampling(method="topk", repeat_guard=True),
        ),
        train_renderer=RendererTraining(
            steps=300,
            batch=4,
            rate=1e-3,
            perceptual_width=8,
            perceptual_scales=(0.5, 0.25, 0.125),
        ),
        train_vq=VQTraining(schedule=Schedule(rate=1e-3, most_steps=150)),
        train_gpt=GPTTraining(schedule=Schedule(rate=1e-3, most_steps=200), checks=10),
        train_refiner=RefinerTraining(
            schedule=Schedule(rate=2e-3, betas=(0.9, 0.999), most_steps=150), checks=10
        ),
        train_avd=AvdTraining(
            schedule=Schedule(rate=1e-3, batch=64, epochs=30, milestones=(20, 25), most_steps=300)
        ),
    )


PRESETS = {"paper": Preset, "lite": _lite, "tiny": _tiny}


def preset(name: str) -> Preset:
    """The preset of a name.

    Raises:
        BadInput: an unknown name.
    """
    if name not in PRESETS:
        raise BadInput(f"--preset {name}: there are {', '.join(PRESETS)}")
    return PRESETS[name]()


def of_points(base: Preset, joints: int) -> Preset:
    """A preset for motion of joints in place of regions."""
    return replace(
        base,
        points=True,
        renderer=replace(base.renderer, regions=joints),
        vq=replace(base.vq, regions=joints, streams=1),
        gpt=replace(base.gpt, streams=1),
        refiner=replace(base.refiner, regions=joints, streams=1),
    )


def parse_overrides(arguments: list[str]) -> dict[str, Any]:
    """Read `key=value` arguments and YAML files into one nested mapping.

    Args:
        arguments: such as "gpt.layers=4" or "mine.yaml"; later ones win.

    Raises:
        BadInput: neither form, or a file that is not a YAML mapping.
    """
    result: dict[str, Any] = {}
    for argument in arguments:
        key, equals, text = argument.partition("=")
        try:
            if equals:
                value = yaml.safe_load(text)
                for name in reversed(key.strip().split(".")):
                    value = {name: value}
                _merge(result, value)
            elif Path(argument).suffix in (".yaml", ".yml"):
                loaded = yaml.safe_load(Path(argument).read_text())
                if not isinstance(loaded, dict):
                    raise BadInput(f"{argument}: not a mapping of keys to values")
                _merge(result, loaded)
            else:
                raise BadInput(f"{argument}: give key=value or a .yaml file")
        except (OSError, yaml.YAMLError, UnicodeDecodeError) as error:
            raise BadInput(f"{argument}: cannot be read ({str(error).splitlines()[0]})") from error
    if "name" in result:
        raise BadInput("name: a preset's name stays; choose one with --preset")
    return result


def override(base: Preset, changes: Mapping[str, Any]) -> Preset:
    """A preset with some values changed; `renderer.regions` is the regions of every part.

    Raises:
        BadInput: an unknown key (the nearest known one is named) or a value of another type.
    """
    changes = dict(changes)
    renderer = changes.get("renderer")
    if isinstance(renderer, Mapping) and "regions" in renderer:
        for part in ("vq", "refiner"):
            given = changes.get(part, {})
            if isinstance(given, Mapping):
                changes[part] = {"regions": renderer["regions"], **given}
    return _replace(base, changes, "")


def _merge(into: dict[str, Any], new: Mapping[str, Any]) -> None:
    for key, value in new.items():
        if isinstance(value, Mapping) and isinstance(into.get(key), dict):
            _merge(into[key], value)
        else:
            into[key] = dict(value) if isinstance(value, Mapping) else value


def _replace(base: T, changes: Mapping[str, Any], prefix: str) -> T:
    hints = typing.get_type_hints(type(base))
    values: dict[str, Any] = {}
    for key, value in changes.items():
        if key not in hints:
            known = difflib.get_close_matches(str(key), hints, n=1, cutoff=0.0)
            hint = f"; the nearest is {prefix}{known[0]}" if known else ""
            raise BadInput(f"{prefix}{key}: no such setting{hint}")
        current = getattr(base, key)
        if dataclasses.is_dataclass(current):
            if not isinstance(value, Mapping):
                raise BadInput(f"{prefix}{key}: holds several settings, name one of them")
            values[key] = _replace(current, value, f"{prefix}{key}.")
        else:
            values[key] = _convert(value, hints[key], f"{prefix}{key}")
    try:
        return dataclasses.replace(base, **values)  # type: ignore[type-var]
    except ValueError as error:
        raise BadInput(f"{prefix.rstrip('.') or 'settings'}: {error}") from error


def _convert(value: Any, hint: Any, name: str) -> Any:
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is tuple:
        listed = list(value) if isinstance(value, (list, tuple)) else []
        endless = len(arguments) == 2 and arguments[1] is Ellipsis
        kinds = [arguments[0]] * len(listed) if endless else list(arguments)
        if isinstance(value, (list, tuple)) and len(kinds) == len(listed):
            return tuple(_convert(v, kind, name) for v, kind in zip(value, kinds, strict=True))
    elif origin in (typing.Union, types.UnionType):
        if value is None:
            return None
        return _convert(value, arguments[0], name)
    elif hint is str and isinstance(value, bool):
        return "on" if value else "off"  # YAML reads these words, too, as truth values
    elif hint is float and _is_number(value) and math.isfinite(float(value)):
        return float(value)
    elif (
        isinstance(hint, type)
        and isinstance(value, hint)
        and (hint is bool or not isinstance(value, bool))
    ):
        return value
    kind = getattr(hint, "__name__", str(hint))
    raise BadInput(f"{name}={value}: a {kind} is wanted")


def _is_number(value: Any) -> bool:
    """Whether `value` is a number; YAML reads 3e-4 without a dot as text."""
    if isinstance(value, bool):
        return False
    try:
        float(value)
    except (TypeError, ValueError):
        return False
    return True
