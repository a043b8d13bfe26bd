"""The ablations of the paper's Table 3: train each variant on a dataset, score all, one table.

A variant is a setting (`vq.quant`, `generation.refine`); everything else is shared, the renderer
and the region motion first of all. Each variant is a whole bundle in the folder, which
`angie animate` can use.
"""

import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import torch

from angie.bundle import OPTIONAL, STAGE_OF, TRAIN, Bundle
from angie.config import Preset, override
from angie.evaluation.evaluate import evaluate
from angie.evaluation.networks import EvaluationConfig, stored_autoencoder
from angie.evaluation.space import open_space
from angie.generators.angie.tokenizer import VQMotionExtractor
from angie.motion.clips import MotionClip
from angie.opening import try_out
from angie.training import train
from data_prep.dataset import Dataset
from data_prep.errors import BadInput
from data_prep.files import check_apart, check_output, whole_file
from data_prep.progress import console
from mraa.training.run import RunConfig

VARIANTS = ("no_quant", "mu_L", "dmu_L", "mu_dL", "no_cholesky", "no_refine", "full")
"""Rows of the table in the paper's order; `no_cholesky` is of its section 3.2."""

COLUMNS = (
    "fgd",
    "bc",
    "diversity_ha2g",
    "l1",
    "perceptual",
    "aed",
    "l1_drawn",
    "perceptual_drawn",
)
"""Columns of the paper's Table 3, and L1 and perceptual distance without the renderer's part."""

MARK = "ablation.json"
"""File of a folder of ablations: what they were made of."""

TABLE = "table3.md"

REPORT = "report"


def settings_of(base: Preset, variant: str) -> Preset:
    """The preset of a variant."""
    if variant == "no_refine":
        return replace(base, generation=replace(base.generation, refine=False))
    return replace(base, vq=replace(base.vq, quant=variant))


def ablate(
    dataset: Path,
    bundle: Path,
    output: Path,
    *,
    variants: Sequence[str] = VARIANTS,
    changes: Mapping[str, Any] | None = None,
    config: EvaluationConfig | None = None,
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
        variants: rows wanted.
        changes: settings that differ from the bundle's, such as training steps.
        config: how to score.
        seed: of every training.
        run: device and so on of the trainings.
        device: torch device for rendering.

    Returns:
        The table, as text.

    Raises:
        BadInput: an unknown variant, an auto-encoder of other regions, or a folder that holds
            something else.
    """
    variants = list(dict.fromkeys(variants))  # a row once, however often it is named
    unknown = [name for name in variants if name not in VARIANTS]
    if unknown or not variants:
        raise BadInput(f"--variants {','.join(unknown)}: there are {', '.join(VARIANTS)}")
    check_apart(output, [dataset, bundle])
    source, data = Bundle.open(bundle), Dataset(dataset)
    if source.preset.points:
        raise BadInput(f"{bundle}: the ablations are of regions")
    source.path_of("renderer")
    if not data.clips("test"):  # told before hours of training
        raise BadInput(f"{dataset}: has no test clips to score the variants on")
    if config is not None and config.fgd is not None:  # told before hours of training
        stored_autoencoder(config.fgd, source.hash_of("renderer"))
    base = override(source.preset, changes or {})
    base = replace(settings_of(base, "full"), generation=replace(base.generation, refine=True))
    for name in variants:
        try_out(settings_of(base, name))
    origin = {
        "renderer": source.hash_of("renderer"),
        "dataset_sha256": data.digest,
        "seed": seed,
        "settings": json.loads(json.dumps(asdict(base))),
    }
    _begin(output, origin)
    for name in ("full", *variants) if "no_refine" in variants else variants:
        _train(dataset, source, output / name, settings_of(base, name), seed, run)
    folders = [output / name for name in variants]
    numbers = evaluate(dataset, folders, output / REPORT, config, device=device, force=True)
    space = open_space(data, Bundle.open(folders[0]), output / "scratch", device)
    broken = {name: broken_share(Bundle.open(output / name), space.test) for name in variants}
    text = table(numbers, broken)
    with whole_file(output / TABLE, force=True) as part:
        part.write_text(text + "\n")
    return text


def _begin(output: Path, origin: dict[str, Any]) -> None:
    """Make the folder, or check that it holds the same ablations.

    Raises:
        BadInput: it holds something else.
    """
    mark = output / MARK
    if mark.is_file():
        if _read(mark) != origin:
            raise BadInput(f"{output}: holds ablations of other settings; name a new folder")
        return
    if output.is_dir() and any(output.iterdir()):
        raise BadInput(f"{output}: holds other files; name a new folder for the ablations")
    check_output(output, force=True)
    output.mkdir(exist_ok=True)
    with whole_file(mark) as part:
        part.write_text(json.dumps(origin, indent=1) + "\n")


def _read(mark: Path) -> Any:
    """What a mark says; None of one that is damaged."""
    try:
        return json.loads(mark.read_text())
    except (OSError, ValueError):
        return None


def _train(
    dataset: Path, source: Bundle, folder: Path, preset: Preset, seed: int, run: RunConfig | None
) -> None:
    """Train what a variant's bundle lacks; renderer and motion are the source's."""
    if not (folder / "bundle.json").is_file():
        begun = folder.with_name(f".{folder.name}.part")  # whole or not at all
        for left in (begun, folder):
            shutil.rmtree(left, ignore_errors=True)
        copy_renderer(source, begun, preset)
        _copy_motion(begun)
        begun.rename(folder)
    full = folder.parent / "full"
    if not preset.generation.refine:
        console.print("no_refine: the parts of full")
        _copy_parts(Bundle.open(full), folder)
        return
    for part in Bundle.open(folder).parts:
        if part in OPTIONAL or Bundle.open(folder).has(part):
            continue
        console.print(f"{folder.name}: {STAGE_OF.get(part, part)}")
        stage = STAGE_OF.get(part, part)
        train(dataset, folder, stage=stage, resume=True, seed=seed, run=run)


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
    places = [folder.parent / name / TRAIN / "motion" for name in VARIANTS]
    measured = next((place for place in places if place.is_dir()), None)
    if measured is not None and not (folder / TRAIN / "motion").is_dir():
        shutil.copytree(measured, folder / TRAIN / "motion")


def _copy_parts(source: Bundle, folder: Path) -> None:
    made = Bundle.open(folder)
    for part, entry in source.manifest["parts"].items():
        shutil.copy(source.path_of(part), folder)
        made.manifest["parts"][part] = dict(entry)
    made.write()


@torch.no_grad()
def broken_share(bundle: Bundle, clips: Sequence[MotionClip]) -> float:
    """Share of the frames of clips, through their own codes, with a C that is none.

    Summed changes of C need not be positive definite; summed Cholesky factors always are.
    """
    generator = bundle.generator()
    broken, frames = 0, 0
    for clip in clips:
        codes = generator.codes_of(clip.motion)
        if codes is not None and isinstance(generator.vq, VQMotionExtractor):
            values = generator.vq.decode_whole(codes)[: clip.motion.frames]
            found = generator.channels.broken(values, clip.motion[:1].vector()[0])
            broken += int(found.sum())
        frames += clip.motion.frames
    return broken / max(frames, 1)


def table(numbers: Mapping[str, Any], broken: Mapping[str, float]) -> str:
    """The table as Markdown, with the rows of reference above the variants.

    Args:
        numbers: what `evaluate` returned, of one space.
        broken: share of frames with a broken covariance, by variant.
    """
    space = numbers["spaces"][0]
    images = {row["name"]: row["scores"] for row in (space["images"] or {"rows": []})["rows"]}
    titles = {entry["key"]: entry for entry in numbers["definitions"]}
    head = ["", *(titles[key]["title"] for key in COLUMNS), "C broken"]
    lines = [head, ["---"] * len(head)]
    for row in space["rows"]:
        scores = {**row["scores"], **images.get(row["name"], {})}
        cells = [row["name"]]
        for key in COLUMNS:
            score = scores.get(key)
            told = score is not None and score["mean"] is not None
            cells.append(f"{score['mean']:.{titles[key]['digits']}f}" if told and score else "-")
        share = broken.get(row["name"])
        cells.append("-" if share is None else f"{100 * share:.1f} %")
        lines.append(cells)
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
