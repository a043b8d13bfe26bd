"""Evaluation from start to end: spaces, rows, scores, pictures, videos, report."""

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from angie import __version__
from angie.bundle import Bundle
from angie.evaluation import report
from angie.evaluation.images import FROM_SOUND, Driver, FrameJudge, score_pictures
from angie.evaluation.networks import (
    EvaluationConfig,
    check_networks,
    find_autoencoder,
    make_frame_judge,
)
from angie.evaluation.people import ABOUT, PeopleJudge, score_people
from angie.evaluation.rows import (
    TRUE_REGIONS,
    Row,
    System,
    baselines,
    generated,
    held,
    resampled,
    row_names,
    systems,
)
from angie.evaluation.scoring import make_judge
from angie.evaluation.space import RegionSpace, Truth, open_space, truths
from angie.evaluation.styles import style_spaces
from angie.evaluation.videos import in_turn, write_videos
from angie.generators.stages import plain
from angie.motion.keypoints import KeypointDataset
from angie.parts import source_commit
from data_prep.dataset import Dataset
from data_prep.errors import BadInput
from data_prep.files import check_apart, whole_folder
from data_prep.progress import progress
from data_prep.rates import FPS
from mraa.renderer import Renderer


def evaluate(
    dataset: Path,
    bundles: Sequence[Path],
    output: Path,
    config: EvaluationConfig | None = None,
    *,
    generator: str | None = None,
    device: str = "cpu",
    force: bool = False,
) -> dict[str, Any]:
    """Score bundles and baselines on the test clips of a dataset, and write the report.

    Args:
        dataset: folder that `angie prepare` made.
        bundles: complete speaker bundles; those of one renderer share a table.
        output: folder of the report.
        config: how.
        generator: the only one of each bundle that is scored; None is all, a row each.
        device: torch device of the renderers.
        force: replace a report that exists.

    Returns:
        the content of results.json.

    Raises:
        BadInput: an input that cannot be used; nothing is left behind.
    """
    config = config or EvaluationConfig()
    check_apart(output, [dataset, *bundles])
    data = Dataset(dataset)
    groups = [(group, systems(group, generator)) for group in _grouped(bundles)]
    check_networks(config, *(entered[0].bundle.hash_of("renderer") for _, entered in groups))
    known = {} if config.truth is None else truths(data, config.truth)
    people = None if config.models is None else PeopleJudge(config.models)
    with whole_folder(output, mark=report.MARK, force=force) as part:
        spaces = []
        for number, (group, entered) in enumerate(groups):
            scratch = part / f"motion-{number}"
            space = open_space(data, entered[0].bundle, scratch, device)
            rows = make_rows(space, entered, config)
            drawn = _drawn(data, space, entered, rows, known, people, config, device)
            scored = score_space(data, space, rows, group, part, number, config, pictures=drawn)
            spaces.append({**scored, "styles": style_spaces(space, entered)})
            shutil.rmtree(scratch, ignore_errors=True)
        return finish(data, spaces, part, config)


def _grouped(folders: Sequence[Path]) -> list[dict[str, Bundle]]:
    """Bundles by name, those of one renderer together.

    Raises:
        BadInput: no bundle, a bundle named twice, or one of joints or without a renderer.
    """
    if not folders:
        raise BadInput("no bundle given; name one or more speaker bundles")
    if len({Path(f).resolve() for f in folders}) < len(folders):
        raise BadInput("a bundle is named twice; name each once")
    groups: dict[str, dict[str, Bundle]] = {}
    for folder, name in zip(folders, row_names(folders), strict=True):
        bundle = Bundle.open(folder)
        if bundle.preset.points:
            raise BadInput(f"{folder}: is a model of joints; score it on a folder of joints")
        bundle.path_of("renderer")
        groups.setdefault(bundle.hash_of("renderer"), {})[name] = bundle
    return list(groups.values())


def make_rows(space: RegionSpace, entered: Sequence[System], config: EvaluationConfig) -> list[Row]:
    """Ground truth, the baselines, and what each system generates."""
    made, rates = [], set()
    with progress("gestures", len(entered), "generators") as advance:
        for system in entered:
            generator = system.load()
            rates.add(generator.fps)
            made.append(
                generated(space, system, generator, config.run_seeds, config.start, config.greedy)
            )
            advance()
    others = [resampled(space, rate) for rate in sorted(rates - {FPS})]
    return [*baselines(space, config.run_seeds), *others, *made]


@dataclass(frozen=True)
class Pictures:
    """What is drawn of a space, for image scores and for videos to look at.

    Attributes:
        renderer: draws, and its region estimator looks at the frames.
        joints: true joints (T, J, 2) of clips, by name, as far as known.
        score: the image scores by a judge of frames, as the report has them.
        videos: writes side-by-side videos into a folder that is there; their names.
        people: the scores of the people in the pictures, as the report has them.
    """

    renderer: Renderer
    joints: dict[str, NDArray]
    score: Callable[[FrameJudge], dict[str, Any]]
    videos: Callable[[Path], list[str]]
    people: Callable[[], dict[str, Any] | None] = lambda: None


def score_space(
    data: Dataset | KeypointDataset,
    space: RegionSpace,
    rows: list[Row],
    bundles: Mapping[str, Bundle],
    folder: Path,
    number: int,
    config: EvaluationConfig,
    *,
    pictures: Pictures | None = None,
    shown: str | None = None,
) -> dict[str, Any]:
    """Everything the report tells of one space; its networks and videos go into `folder`.

    `data`: the clips, with their frames where pictures are drawn. `rows`: the ground truth first.
    `number`: of the space in the report. `shown`: name of the clip whose activity is plotted; None
    for the first speaker's first.
    """
    model, scale, origin = find_autoencoder(space, folder, number, config)
    judge = make_judge(space, model, scale)
    bins = report.speed_bins(rows[0].runs[0], judge)
    numbers = [report.numbers_of_row(row, judge, bins) for row in rows]
    images, people, videos = None, None, []
    if pictures is not None:
        assert isinstance(data, Dataset)
        renderer, joints = pictures.renderer, pictures.joints
        frame_judge, more = make_frame_judge(data, space, renderer, joints, folder, number, config)
        origin |= more
        images, people = pictures.score(frame_judge), pictures.people()
        place = folder / f"videos-{number}"
        if config.videos_shown:
            place.mkdir()
            videos = [f"{place.name}/{name}" for name in pictures.videos(place)]
    shown = shown or space.test[in_turn(space.test, 1)[0]].name
    described = {name: describe(bundle, data) for name, bundle in bundles.items()}
    return report.numbers_of_space(space, judge, rows, numbers, shown, bins, origin, described) | {
        "images": images,
        "people": people,
        "videos": videos,
    }


def describe(bundle: Bundle, data: Dataset | KeypointDataset) -> dict[str, Any]:
    """What a report says of a bundle."""
    parts = bundle.manifest["parts"]
    trained = parts["statistics" if bundle.preset.points else "renderer"]["report"]
    return {
        "preset": bundle.preset.name,
        "parts": {name: entry["sha256"] for name, entry in parts.items()},
        "trained_on": trained.get("dataset", ""),
        "trained_on_this_dataset": trained.get("dataset_sha256") == data.digest,
        "generation": plain({name: bundle.settings(name) for name in bundle.generators}),
    }


def _drawn(
    data: Dataset,
    space: RegionSpace,
    entered: Sequence[System],
    rows: Sequence[Row],
    known: dict[str, Truth],
    people: PeopleJudge | None,
    config: EvaluationConfig,
    device: str,
) -> Pictures | None:
    """The pictures of bundles of one renderer; None where none are wanted."""
    if not config.images:
        return None
    renderer = entered[0].bundle.renderer().to(device)
    joints = {name: truth.joints for name, truth in known.items()}
    return Pictures(
        renderer,
        joints,
        partial(_score_images, data, space, entered, rows, joints, config),
        lambda folder: write_videos(folder, data, space.test, rows, renderer, config.videos_shown),
        lambda: _score_people(data, space, renderer, known, people, config),
    )


def _score_images(
    data: Dataset,
    space: RegionSpace,
    entered: Sequence[System],
    rows: Sequence[Row],
    joints: dict[str, NDArray],
    config: EvaluationConfig,
    judge: FrameJudge,
) -> dict[str, Any]:
    """Image scores of the true regions, of stillness, and of generators' reconstructions."""
    about = {
        TRUE_REGIONS: "Drawn from the regions of the recorded frames: the renderer only.",
        "motionless": "Drawn from the first pose throughout.",
    }
    drivers: dict[str, Driver] = {"motionless": held}
    for system in entered:
        if system.family.reconstruct is not None:
            drivers[system.name] = _through_tokens(system)
            about[system.name] = "Drawn from its reconstruction of the true motion."
        if config.from_sound:
            name = f"{system.name}{FROM_SOUND}"
            drivers[name] = _from_sound(rows, system.name)
            about[name] = "Drawn from the motion that it generates to the sound."
    frames = sum(len(config.choice.numbers(c.motion.frames)) for c in space.test)
    with progress("image scores", frames * len(about), "frames") as advance:
        scores = score_pictures(judge, data, space.test, drivers, joints, config.choice, advance)
    return {
        "about": f"{config.choice}. Perceptual distance by {judge.perceptual.backend}.",
        "rows": [report.numbers_of_images(n, about[n], s) for n, s in scores.items()],
    }


def _score_people(
    data: Dataset,
    space: RegionSpace,
    renderer: Renderer,
    known: dict[str, Truth],
    people: PeopleJudge | None,
    config: EvaluationConfig,
) -> dict[str, Any] | None:
    """What is left of the people in what the renderer draws; None without networks that see it."""
    if people is None:
        return None
    frames = sum(len(config.choice.numbers(c.motion.frames)) for c in space.test)
    with progress("people", frames, "frames") as advance:
        scores = score_people(people, renderer, data, space.test, known, config.choice, advance)
    return {
        "about": f"{config.choice}. All frames are encoded alike, as those of the dataset.",
        "rows": [report.numbers_of_images(n, ABOUT[n], s) for n, s in scores.items()],
    }


def _through_tokens(system: System) -> Driver:
    """Gives a clip's motion as the generator's own tokens give it back."""
    through, generator = system.family.reconstruct, system.load()
    assert through is not None
    return lambda clip: through(generator, clip, system.knows(clip.speaker))


def _from_sound(rows: Sequence[Row], name: str) -> Driver:
    """Gives the motion of a clip in the first run of a row."""
    run = next(row for row in rows if row.name == name).runs[0]
    made = {performance.clip: performance.motion for performance in run}
    return lambda clip: made[clip.name]


def finish(
    data: Dataset | KeypointDataset,
    spaces: list[dict[str, Any]],
    folder: Path,
    config: EvaluationConfig,
) -> dict[str, Any]:
    """Write the report of spaces into a folder; the content of its results.json."""
    about: dict[str, Any] = {
        "name": data.path.resolve().name,
        "sha256": data.digest,
        "fps": FPS,
        "speakers": data.speakers(),
    }
    for split in ("train", "test"):
        clips = data.clips(split)
        about[f"{split}_clips"] = len(clips)
        about[f"{split}_minutes"] = round(sum(clip.n_frames for clip in clips) / FPS / 60, 3)
    numbers = {
        "angie": __version__,
        "commit": source_commit(),
        "dataset": about,
        "options": config.as_dict(),
        "spaces": spaces,
        "definitions": [asdict(d) for d in report.ALL],
    }
    report.write_report(folder, data.path.resolve().name, numbers)
    return numbers
