"""Models of joints, and arrays of any system, on a folder of joints: the paper's Table 1.

The rows and scores are those of regions, of joints at 25 frames a second; nothing is drawn. Such
numbers are never comparable with those of regions.
"""

import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from angie.bundle import Bundle
from angie.evaluation import report
from angie.evaluation.evaluate import finish, make_rows, score_space
from angie.evaluation.networks import EvaluationConfig, check_networks
from angie.evaluation.rows import Row, perform, row_names, systems
from angie.evaluation.space import RegionSpace
from angie.evaluation.styles import style_spaces
from angie.motion.keypoints import KeypointDataset, read_points, read_rate, resample
from angie.motion.statistics import measure
from data_prep.errors import BadInput
from data_prep.files import check_apart, whole_folder
from data_prep.rates import FPS, FRAMES_PER_TOKEN
from mraa.motion import Motion


def evaluate_joints(
    folder: Path,
    places: Sequence[Path],
    output: Path,
    config: EvaluationConfig | None = None,
    *,
    generator: str | None = None,
    force: bool = False,
) -> dict[str, Any]:
    """Score models of joints and arrays on the test clips of a folder of joints.

    Args:
        folder: joints with their sound, see `angie.motion.keypoints`.
        places: bundles of joints, and folders of any system's `<clip>.npy` or `.npz` with
            `points` (T, J, 2), named like test clips and at the clips' own rate (or at the
            file's `fps`).
        output: folder of the report.
        config: how; nothing is drawn.
        generator: the only one of each bundle that is scored; None is all, a row each.
        force: replace a report that exists.

    Returns and raises what `angie.evaluation.evaluate.evaluate` does.
    """
    config = replace(config or EvaluationConfig(), images=False)
    check_apart(output, [folder, *places])
    if len({Path(place).resolve() for place in places}) < len(places):
        raise BadInput("a system is named twice; name each once")
    models, arrays = _told_apart(places)
    entered = systems(models, generator)
    with whole_folder(output, mark=report.MARK, force=force) as part:
        kept = [model.train / "features" for model in models.values()]
        cache = next((place for place in kept if place.is_dir()), part / "features")
        data = KeypointDataset(folder, cache)
        _check(data, models, config)
        found = {name: read_arrays(data, place) for name, place in arrays.items()}
        data.check_sound()
        space = open_joints(data)
        rows = make_rows(space, entered, config)
        rows += [array_row(space, name, motions) for name, motions in found.items()]
        result = score_space(data, space, rows, models, part, 0, config)
        result["styles"] = style_spaces(space, entered)
        for name, motions in found.items():
            result["warnings"] += shorter_or_longer(space, name, motions)
        shutil.rmtree(part / "features", ignore_errors=True)
        return finish(data, [result], part, config)


def _told_apart(places: Sequence[Path]) -> tuple[dict[str, Bundle], dict[str, Path]]:
    """Bundles, and folders of arrays, by the names of their rows.

    Raises:
        BadInput: no folder, or a model of regions.
    """
    models, arrays = {}, {}
    for place, name in zip(places, row_names(places), strict=True):
        if (place / "bundle.json").is_file():
            models[name] = Bundle.open(place)
            if not models[name].preset.points:
                raise BadInput(f"{place}: is a model of regions; score it on a dataset of videos")
        elif place.is_dir():
            arrays[name] = place
        else:
            raise BadInput(f"{place}: is not a folder; give models of joints, or folders of arrays")
    return models, arrays


def _check(data: KeypointDataset, models: dict[str, Bundle], config: EvaluationConfig) -> None:
    """See that models and the stored auto-encoder fit the joints.

    Raises:
        BadInput: they do not, or there is no training or no test clip, or a speaker has test
            clips only.
    """
    for split in ("train", "test"):
        if not data.clips(split):
            raise BadInput(f"{data.path}: has no {split} clips to score with")
    known = {clip.speaker for clip in data.clips("train")}
    unknown = sorted({clip.speaker for clip in data.clips("test")} - known)
    if unknown:
        raise BadInput(f"{data.path}: {', '.join(unknown)}: FGD needs training clips of a speaker")
    for name, model in models.items():
        regions = model.statistics().regions
        if regions != data.joints():
            raise BadInput(f"{name}: has {regions} joints, {data.path} {data.joints()}")
    check_networks(config, data.digest)


def open_joints(data: KeypointDataset) -> RegionSpace:
    """The clips of a folder of joints, at 25 frames a second.

    Raises:
        BadInput: no joint moves.
    """
    train, test = (data.motion_clips(split) for split in ("train", "test"))
    space = RegionSpace(data.digest, train, test, measure(train), "joints")
    if not space.active.any():
        raise BadInput(f"{data.path}: no joint moves in the training clips")
    return space


def read_arrays(data: KeypointDataset, folder: Path) -> dict[str, Motion]:
    """Motion at 25 frames a second of the test clips that a folder has arrays of, by their names.

    Raises:
        BadInput: an array that cannot be used, or none named like a test clip.
    """
    found = {}
    for clip in data.clips("test"):
        paths = [folder / f"{clip.id}{ending}" for ending in (".npy", ".npz")]
        path = next((path for path in paths if path.is_file()), None)
        if path is None:
            continue
        points = read_points(path)
        if points.shape[1] != data.joints():
            raise BadInput(f"{path}: has {points.shape[1]} joints, {data.path} {data.joints()}")
        moved = resample(points, read_rate(path) or clip.fps, FPS)
        found[clip.id] = Motion.of_points(torch.from_numpy(moved).float())
    if not found:
        raise BadInput(f"{folder}: holds no array named like a test clip of {data.path}")
    return found


def array_row(space: RegionSpace, name: str, motions: dict[str, Motion]) -> Row:
    """The row of a folder of arrays."""
    clips = [clip for clip in space.test if clip.name in motions]
    run = [perform(clip, motions[clip.name]) for clip in clips]
    there, wanted = (
        sum(part) / FPS
        for part in ([p.motion.frames for p in run], [clip.motion.frames for clip in clips])
    )
    about = f"Arrays of {len(run)} of {len(space.test)} test clips, {there:.1f} of {wanted:.1f} s."
    return Row(name, about, [run])


def shorter_or_longer(space: RegionSpace, name: str, motions: dict[str, Motion]) -> list[str]:
    """Warnings of arrays that differ in length from their clips by more than a token."""
    apart = [
        clip.name
        for clip in space.test
        if clip.name in motions
        and abs(motions[clip.name].frames - clip.motion.frames) > FRAMES_PER_TOKEN
    ]
    if not apart:
        return []
    return [f"{name}: {len(apart)} arrays, such as {apart[0]}, are not as long as their clips; "
            "both are cut to the shorter"]  # fmt: skip
