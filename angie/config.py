"""Presets `paper`, `lite` and `tiny`: every size and every number of training in one place."""

import dataclasses
import difflib
import math
import types
import typing
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import yaml

from angie.generators import DEFAULT, family
from data_prep.errors import BadInput, check_choice
from data_prep.media.container import check_file
from mraa.renderer import GeneratorConfig, HourglassConfig, RendererConfig
from mraa.training.avd import AvdTraining
from mraa.training.checkpoint import Schedule
from mraa.training.objective import RendererTraining
from mraa.training.pairs import Augmentation

T = TypeVar("T")


@dataclass(frozen=True)
class Preset:
    """Sizes and training of the parts that all generators share; the defaults are the papers'.

    Attributes:
        name: of the preset.
        points: joints in place of regions; there is no renderer.
        renderer: sizes; its `regions` are those of every part.
        train_renderer: how the renderer is trained.
        train_avd: how the disentanglement network is trained.
        generators: settings of each generator by its family's name: objects, or plain mappings
            of families that nobody has asked for yet, see `settings`.
    """

    name: str = "paper"
    points: bool = False
    renderer: RendererConfig = field(default_factory=RendererConfig)
    train_renderer: RendererTraining = field(default_factory=RendererTraining)
    train_avd: AvdTraining = field(default_factory=AvdTraining)
    generators: Mapping[str, Any] = field(default_factory=dict)

    def settings(self, name: str) -> Any:
        """Settings of a family.

        Raises:
            BadInput: no such generator here, or settings that its family does not have.
        """
        if name not in self.generators:
            raise BadInput(f"{name}: no such generator; there is {', '.join(self.generators)}")
        given = self.generators[name]
        if isinstance(given, Mapping):
            return _replace(family(name).settings(), given, f"{name}.")
        return given


def _lite() -> Preset:
    """What ships: renders in real time on a laptop CPU, the photo itself warped."""
    return Preset(
        name="lite",
        renderer=RendererConfig(
            estimator=HourglassConfig(16, 5, 128),
            background=HourglassConfig(16, 4, 64),
            background_scale=0.25,
            flow=HourglassConfig(32, 5, 128),
            generator=GeneratorConfig(
                "deep",
                width=128,
                bottleneck_blocks=6,
                refine_blocks=8,
                half_blocks=2,
                fine_occlusion=True,
            ),
            affine_mode="sym",
        ),
        train_renderer=RendererTraining(
            batch=8,
            repeats=150,
            perceptual_width=16,
            perceptual_scales=(0.5, 0.25, 0.125),
            equivariance_shift=2.0,
            equivariance_affine=1.0,
            augmentation=Augmentation(zoom=0.15, background=0.8),
            warmup_steps=3000,
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
        train_renderer=RendererTraining(
            steps=300, batch=4, rate=1e-3, perceptual_width=8, perceptual_scales=(0.5, 0.25, 0.125)
        ),
        train_avd=AvdTraining(
            schedule=Schedule(rate=1e-3, batch=64, epochs=30, milestones=(20, 25), most_steps=300)
        ),
    )


PRESETS = {"paper": Preset, "lite": _lite, "tiny": _tiny}


def preset(name: str, generator: str | None = None) -> Preset:
    """The preset of a name, with the settings of one generator; `BadInput` of an unknown name."""
    check_choice("--preset", name, PRESETS)
    return with_generator(PRESETS[name](), generator)


def with_generator(base: Preset, generator: str | None = None) -> Preset:
    """A preset that has a generator as well, with the family's own settings for it."""
    found = family(generator)
    if found.name in base.generators:
        return base
    settings = found.fit(found.preset(base.name), base.renderer.regions, base.points)
    return replace(base, generators={**base.generators, found.name: settings})


def fitted(base: Preset) -> Preset:
    """A preset whose generators' settings are for its regions or points."""
    made = {
        name: family(name).fit(base.settings(name), base.renderer.regions, base.points)
        for name in base.generators
    }
    return replace(base, generators=made)


def of_points(base: Preset, joints: int) -> Preset:
    """A preset for motion of joints in place of regions."""
    return fitted(replace(base, points=True, renderer=replace(base.renderer, regions=joints)))


def parse_overrides(arguments: list[str]) -> dict[str, Any]:
    """Read `key=value` arguments and YAML files into one nested mapping.

    Args:
        arguments: such as "renderer.regions=12" or "mine.yaml"; later ones win.

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
                check_file(Path(argument))
                loaded = yaml.safe_load(Path(argument).read_bytes())
                if not isinstance(loaded, dict):
                    raise BadInput(f"{argument}: not a mapping of keys to values")
                _merge(result, loaded)
            else:
                raise BadInput(f"{argument}: give key=value or a .yaml file")
        except (OSError, yaml.YAMLError, ValueError, RecursionError) as error:
            raise BadInput(f"{argument}: cannot be read ({str(error).splitlines()[0]})") from error
    if "name" in result:
        raise BadInput("name: a preset's name stays; choose one with --preset")
    return result


def override(base: Preset, changes: Mapping[str, Any]) -> Preset:
    """A preset with some values changed; `renderer.regions` is the regions of every part.

    Keys that are no section of `Preset` are settings of the generators: those of the family
    `NAME` are under `NAME`, those of the default family stand for themselves as well.

    Raises:
        BadInput: an unknown key (the nearest known one is named) or a value of another type.
    """
    shared: dict[str, Any] = {}
    own: dict[str, dict[str, Any]] = {}
    for key, value in changes.items():
        if key in _SECTIONS:
            shared[key] = value
        elif key in base.generators:
            _merge(own.setdefault(key, {}), _several(value, key))
        else:
            _merge(own.setdefault(DEFAULT, {}), {key: value})
    changed = _replace(base, shared, "")
    points = (base.points, base.renderer.regions) != (changed.points, changed.renderer.regions)
    generators = dict(base.generators)
    for name in {*own, *generators} if points else own:
        generators[name] = _changed(changed, name, own.get(name, {}))
    return replace(changed, generators=generators)


def stored(config: Mapping[str, Any]) -> Preset:
    """The preset of a bundle's manifest, as `override`; generators' settings are read later."""
    generators = _several(config.get("generators", {}), "generators")
    shared = {key: value for key, value in config.items() if key != "generators"}
    return replace(override(Preset(), shared), generators=generators)


def _changed(base: Preset, name: str, changes: Mapping[str, Any]) -> Any:
    """Settings of a family for the preset's regions, some of them changed."""
    prefix = "" if name == DEFAULT else f"{name}."
    if name not in base.generators:
        raise _unknown(next(iter(changes)), _SECTIONS, "")
    found, regions, points = family(name), base.renderer.regions, base.points
    known = {entry.name for entry in dataclasses.fields(found.settings)}
    for key in changes.keys() - known:
        raise _unknown(key, known | (_SECTIONS if name == DEFAULT else set()), prefix)
    made = _replace(found.fit(base.settings(name), regions, points), changes, prefix)
    if found.fit(made, regions, points) != made:
        raise BadInput(f"{name}: the parts disagree: regions are set for one part only")
    return made


_SECTIONS = {entry.name for entry in dataclasses.fields(Preset)} - {"generators"}


def _several(value: Any, key: str) -> Mapping[str, Any]:
    """A value that has to be a mapping of settings; else `BadInput`."""
    if not isinstance(value, Mapping):
        raise BadInput(f"{key}: holds several settings, name one of them")
    return value


def _unknown(key: str, known: Iterable[str], prefix: str) -> BadInput:
    near = difflib.get_close_matches(str(key), known, n=1, cutoff=0.0)
    hint = f"; the nearest is {prefix}{near[0]}" if near else ""
    return BadInput(f"{prefix}{key}: no such setting{hint}")


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
            raise _unknown(key, hints, prefix)
        current = getattr(base, key)
        if dataclasses.is_dataclass(current):
            name = f"{prefix}{key}"
            values[key] = _replace(current, _several(value, name), f"{name}.")
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
    elif hint is float and not isinstance(value, bool):
        with suppress(TypeError, ValueError):  # YAML reads 3e-4 without a dot as text
            if math.isfinite(float(value)):
                return float(value)
    elif (
        isinstance(hint, type)
        and isinstance(value, hint)
        and (hint is bool or not isinstance(value, bool))
    ):
        return value
    kind = getattr(hint, "__name__", str(hint))
    raise BadInput(f"{name}={value}: a {kind} is wanted")
