"""The ablations of the paper's Table 3: train each variant on a dataset, score all, one table.

A variant is a setting of the generator; everything else is shared, the renderer and the region
motion first of all. Each variant is a whole bundle in the folder, which `angie animate` can use.
"""

import json
import shutil
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from angie.bundle import TRAIN, Bundle
from angie.config import Preset, override
from angie.evaluation.evaluate import evaluate
from angie.evaluation.networks import EvaluationConfig, stored_autoencoder
from angie.evaluation.space import RegionSpace, open_space
from angie.evaluation.table3 import EARLY, Trained, tables
from angie.generators import DEFAULT, family
from angie.generators.base import Family
from angie.opening import try_out
from angie.parts import OPTIONAL
from angie.training import stages_of, train
from data_prep.dataset import Dataset
from data_prep.errors import BadInput
from data_prep.files import alone, check_apart, check_output, whole_file
from data_prep.progress import console
from mraa.training.run import RunConfig

MARK = "ablation.json"
"""File that marks a folder of ablations and holds their settings."""

TABLE = "table3.md"

REPORT, REPORT_EARLY = "report", "report-early"
"""Reports of whole clips, and of the pictures of their first two seconds."""


def settings_of(base: Preset, variant: str, generator: str = DEFAULT) -> Preset:
    """The preset of a variant of a generator."""
    change = family(generator).variants[variant].change
    changed = change(base.settings(generator))
    return replace(base, generators={**base.generators, generator: changed})


def ablate(
    dataset: Path,
    bundle: Path,
    output: Path,
    *,
    variants: Sequence[str] | None = None,
    generator: str | None = None,
    changes: Mapping[str, Any] | None = None,
    config: EvaluationConfig | None = None,
    trainings: int = 1,
    seed: int = 0,
    run: RunConfig | None = None,
    device: str = "cpu",
) -> str:
    """Train and score the variants; a killed run goes on when repeated.

    Args:
        dataset: folder that `angie prepare` made, with test clips.
        bundle: its renderer and settings are every variant's.
        output: folder for the variants' bundles, `report` (see `angie.evaluation`) and the
            table.
        variants: rows wanted; None is all of the generator's.
        generator: whose variants; None is the bundle's default one.
        changes: settings that differ from the bundle's, such as training steps.
        config: how to score; pictures are of both protocols, reconstructions and from sound.
        trainings: seeds, from `seed` on, that the variants are trained with which the comparison
            stands on (`Variant.several`); the others are trained once.
        seed: of every training.
        run: device and so on of the trainings.
        device: torch device for rendering.

    Returns:
        The tables, as text.

    Raises:
        BadInput: an unknown variant, an auto-encoder of other regions, or a folder that holds
            something else.
    """
    check_apart(output, [dataset, bundle])
    source, data = Bundle.open(bundle), Dataset(dataset)
    found = family(source.chosen(generator))
    known = found.variants
    variants = list(known) if variants is None else list(dict.fromkeys(variants))
    unknown = [name for name in variants if name not in known]
    if unknown or not variants:
        raise BadInput(f"--variants {','.join(unknown)}: choose from {', '.join(known) or 'none'}")
    if source.preset.points:
        raise BadInput(f"{bundle}: the ablations are of regions")
    source.path_of("renderer")
    if not data.clips("test"):  # before hours of training
        raise BadInput(f"{dataset}: has no test clips to score the variants on")
    if config is not None and config.fgd is not None:  # before hours of training
        stored_autoencoder(config.fgd, source.hash_of("renderer"))
    base = override(source.preset, changes or {})
    base = replace(base, generators={found.name: base.settings(found.name)})
    for name in variants:
        try_out(settings_of(base, name, found.name))
    origin = {
        "renderer": source.hash_of("renderer"),
        "dataset_sha256": data.digest,
        "seed": seed,
        "settings": json.loads(json.dumps(asdict(base))),
    }
    with alone(output):
        _begin(output, origin)
        needed = [known[name].parts_of for name in variants]
        rows = {
            name: [name] for name in dict.fromkeys([*(one for one in needed if one), *variants])
        }
        for name, names in rows.items():
            if known[name].several and name in variants:
                names += [f"{name}-{seed + i}" for i in range(1, trainings)]
            for i, one in enumerate(names):
                preset = settings_of(base, name, found.name)
                _train(dataset, source, output / one, preset, known[name].parts_of, seed + i, run)
        folders = [output / one for name in variants for one in rows[name]]
        config = replace(config or EvaluationConfig(), from_sound=True)
        numbers = evaluate(dataset, folders, output / REPORT, config, device=device, force=True)
        early = None
        if config.images and not config.image_seconds:
            stored = output / REPORT / "fgd-0.safetensors"
            seconds = replace(config, image_seconds=EARLY, fgd=stored if stored.is_file() else None)
            early = evaluate(
                dataset, folders, output / REPORT_EARLY, seconds, device=device, force=True
            )
        space = open_space(data, Bundle.open(folders[0]), output / "scratch", device)
        trained = {
            name: Trained(rows[name], _shares(found, output / name, space), _steps(output / name))
            for name in variants
        }
        text = tables(numbers, early, trained)
        with whole_file(output / TABLE, force=True) as part:
            part.write_text(text + "\n")
        return text


def _shares(found: Family, folder: Path, space: RegionSpace) -> dict[str, float]:
    """Further columns of a variant, by their titles."""
    generator = Bundle.open(folder).generator()
    return {title: share(generator, space.test) for title, share in found.columns.items()}


def _steps(folder: Path) -> dict[str, int]:
    """Steps at which the stages of a variant's training stopped."""
    parts = Bundle.open(folder).manifest["parts"]
    return {
        part.partition(".")[2]: entry["report"]["steps"]
        for part, entry in parts.items()
        if "steps" in entry["report"]
    }


def _begin(output: Path, origin: dict[str, Any]) -> None:
    """Make the folder, or check that it holds the same ablations.

    Raises:
        BadInput: it holds something else.
    """
    mark = output / MARK
    if mark.is_file():
        kept = None
        with suppress(OSError, ValueError):  # of a damaged one nothing is known
            kept = json.loads(mark.read_bytes())
        if kept != origin:
            raise BadInput(f"{output}: holds ablations of other settings; name a new folder")
        return
    if output.is_dir() and any(output.iterdir()):
        raise BadInput(f"{output}: holds other files; name a new folder for the ablations")
    check_output(output, force=True)
    output.mkdir(exist_ok=True)
    with whole_file(mark) as part:
        part.write_text(json.dumps(origin, indent=1) + "\n")


def _train(
    dataset: Path,
    source: Bundle,
    folder: Path,
    preset: Preset,
    parts_of: str | None,
    seed: int,
    run: RunConfig | None,
) -> None:
    """Train what a variant's bundle lacks; renderer and motion are the source's."""
    if not (folder / "bundle.json").is_file():
        begun = folder.with_name(f".{folder.name}.part")  # whole or not at all
        for left in (begun, folder):
            shutil.rmtree(left, ignore_errors=True)
        copy_renderer(source, begun, preset)
        _copy_motion(begun)
        begun.rename(folder)
    if parts_of is not None:
        console.print(f"{folder.name}: the parts of {parts_of}")
        _copy_parts(Bundle.open(folder.parent / parts_of), folder)
        return
    bundle = Bundle.open(folder)
    name = bundle.chosen()
    for stage, (part, _) in stages_of(bundle, family(name)).items():
        if part in OPTIONAL or Bundle.open(folder).has(part):
            continue
        console.print(f"{folder.name}: {stage}")
        train(dataset, folder, generator=name, stage=stage, resume=True, seed=seed, run=run)


def copy_renderer(source: Bundle, folder: Path, preset: Preset) -> None:
    """A bundle with the renderer, and the region motion that was measured with it."""
    made = Bundle.create(folder, preset)
    for key in ("speakers", "crop"):
        made.manifest[key] = source.manifest[key]
    measured = source.train / "motion"
    if measured.is_dir():
        shutil.copytree(measured, made.train / "motion")
    shutil.copy(source.path_of("renderer"), folder)
    made.manifest["parts"]["renderer"] = dict(source.manifest["parts"]["renderer"])
    made.write()


def _copy_motion(folder: Path) -> None:
    """Give a variant the region motion that one before it has measured, if it has none."""
    places = sorted(folder.parent.glob(f"*/{TRAIN}/motion"))
    measured = next((place for place in places if place.is_dir()), None)
    if measured is not None and not (folder / TRAIN / "motion").is_dir():
        shutil.copytree(measured, folder / TRAIN / "motion")


def _copy_parts(source: Bundle, folder: Path) -> None:
    made = Bundle.open(folder)
    for part, entry in source.manifest["parts"].items():
        shutil.copy(source.path_of(part), folder)
        made.manifest["parts"][part] = dict(entry)
    made.write()
