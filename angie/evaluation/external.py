"""Videos of any system against a dataset: regions by the bundle's estimator, sound of their own."""

import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from angie.bundle import Bundle
from angie.evaluation import report
from angie.evaluation.evaluate import Pictures, finish, score_space
from angie.evaluation.images import FrameJudge, FrameScores, compare, pick, read_chosen
from angie.evaluation.networks import EvaluationConfig, check_networks
from angie.evaluation.rows import Performance, Row, baselines, row_names
from angie.evaluation.space import RegionSpace, onsets_within, open_space, true_joints
from angie.evaluation.videos import padded, write_video
from angie.metrics.images import read_pair
from angie.motion.clips import MotionClip
from data_prep.dataset import Clip, Dataset
from data_prep.errors import BadInput
from data_prep.files import check_apart, whole_folder
from data_prep.media.audio import read_sound
from data_prep.media.video import probe, read_frames
from data_prep.prepare.source import videos_in
from data_prep.progress import progress
from data_prep.rates import FPS, IMAGE_SIZE
from data_prep.speech.features import Speech
from mraa.extract import measure_motion
from mraa.regions import RegionEstimator


@dataclass(frozen=True)
class Watched:
    """A video after it has been looked at.

    Attributes:
        path: the file.
        clip: the reference's test clip of the same name, or None.
        performance: its motion and sound.
    """

    path: Path
    clip: MotionClip | None
    performance: Performance


def check_square(path: Path) -> None:
    """See from its header that a video can be scored.

    Raises:
        BadInput: not square, or not readable.
    """
    info = probe(path)
    if info.width != info.height:
        raise BadInput(
            f"{path}: is {info.width}x{info.height}; give square videos that show what the "
            "dataset's clips show"
        )


def square_frames(path: Path) -> Iterator[NDArray]:
    """Frames (256, 256, 3) uint8 of a square video at 25 a second, resized where need be.

    Raises:
        BadInput: not square, or not readable.
    """
    check_square(path)
    for frame in read_frames(path):
        if len(frame) != IMAGE_SIZE:
            how = cv2.INTER_AREA if len(frame) > IMAGE_SIZE else cv2.INTER_CUBIC
            frame = cv2.resize(frame, (IMAGE_SIZE, IMAGE_SIZE), interpolation=how)
        yield frame


def watch(path: Path, space: RegionSpace, estimator: RegionEstimator) -> Watched:
    """Measure a video's motion and hear its sound.

    The sound is that of the file, else that of the reference's test clip of the same name; a video
    with neither has no onsets. The speaker is that of the training or test clip of this name; a
    video without one is of the dataset's only speaker, if there is but one, else of an unknown
    one.

    Raises:
        BadInput: the video cannot be used.
    """
    info = probe(path)
    motion = measure_motion(estimator, square_frames(path))
    clip = next((clip for clip in space.test if clip.name == path.stem), None)
    own = next((clip for clip in space.train if clip.name == path.stem), clip)
    frames = motion.frames if clip is None else min(motion.frames, clip.motion.frames)
    if info.has_sound:
        times = Speech(read_sound(path, origin=info.start))["onset_times"].astype(np.float64)
        onsets = times[times < frames / FPS]
    else:
        onsets = np.zeros(0) if clip is None else onsets_within(clip, frames)
    speakers = space.statistics.speakers
    speaker = own.speaker if own else (speakers[0] if len(speakers) == 1 else None)
    truth = None if clip is None else clip.motion[:frames]
    return Watched(path, clip, Performance(path.stem, speaker, motion[:frames], onsets, truth))


def evaluate_videos(
    folder: Path,
    reference: Path,
    bundle_folder: Path,
    output: Path,
    config: EvaluationConfig | None = None,
    *,
    device: str = "cpu",
    force: bool = False,
) -> dict[str, Any]:
    """Score a folder of videos of any system, and write the report.

    Args:
        folder: videos, square, framed as the clips; those named like a test clip are compared
            with it.
        reference: dataset with the true motion of test clips.
        bundle_folder: bundle whose region estimator sees both; only its renderer is needed.
        output: folder of the report.
        config: how.
        device: torch device of the estimator.
        force: replace a report that exists.

    Returns and raises what `angie.evaluation.evaluate.evaluate` does.
    """
    config = config or EvaluationConfig()
    check_apart(output, [folder, reference, bundle_folder])
    data, bundle = Dataset(reference), Bundle.open(bundle_folder)
    if not Path(folder).is_dir():
        raise BadInput(f"{folder}: is not a folder; give one with videos")
    paths = videos_in(Path(folder))
    if not paths:
        raise BadInput(f"{folder}: holds no videos")
    for path in paths:
        check_square(path)
    check_networks(config, bundle.hash_of("renderer"))
    own = config.detected
    if own is not None and not any((own / f"{path.stem}.npz").is_file() for path in paths):
        raise BadInput(f"{own}: holds no NAME.npz for a video NAME of {folder}")
    joints = {} if config.truth is None else true_joints(data, config.truth)
    with whole_folder(output, mark=report.MARK, force=force) as part:
        scratch = part / "motion-0"
        space = open_space(data, bundle, scratch, device)
        renderer, watched = bundle.renderer().to(device), []
        with progress("videos", len(paths), "videos") as advance:
            for path in paths:
                watched.append(watch(path, space, renderer.estimator))
                advance()
        known = sum(w.clip is not None for w in watched)
        (name,) = row_names([folder])
        about = f"{len(watched)} videos, {known} of them named like a test clip of the dataset."
        rows = [
            *baselines(space, config.run_seeds),
            Row(name, about, [[w.performance for w in watched]]),
        ]
        matched = [w for w in watched if w.clip is not None]
        drawn = Pictures(
            renderer,
            joints,
            partial(_score_images, data, name, about, matched, joints, config),
            partial(_write_videos, data, name, matched[: config.videos_shown]),
        )
        result = score_space(
            data, space, rows, {bundle_folder.name: bundle}, part, 0, config,
            pictures=drawn if config.images else None,
            shown=matched[0].path.stem if matched else None,
        )  # fmt: skip
        shutil.rmtree(scratch, ignore_errors=True)
        return finish(data, [result], part, config)


def _score_images(
    data: Dataset,
    name: str,
    about: str,
    watched: Sequence[Watched],
    joints: dict[str, NDArray],
    config: EvaluationConfig,
    judge: FrameJudge,
) -> dict[str, Any]:
    """Image scores of the videos that are named like a clip."""
    gathered, stored = FrameScores(), _stored(data)
    if config.detected is not None:
        _add_detected(config.detected, [w.path.stem for w in watched], gathered)
        judge = replace(judge, identity=None)
    for w in watched:
        assert w.clip is not None
        numbers = config.choice.numbers(w.performance.motion.frames)
        if not len(numbers):
            continue
        true, _ = read_chosen(data, stored[w.clip.name], numbers)
        seen = pick(w.clip.motion, numbers)
        known = joints.get(w.clip.name)
        part = None if known is None else known[numbers]
        shown = np.stack([frame for i, frame in enumerate(square_frames(w.path)) if i in numbers])
        compare(judge, gathered, true, shown, seen, part)
    return {
        "about": f"{config.choice}, of the videos named like a test clip. Perceptual distance by "
        f"{judge.perceptual.backend}.",
        "rows": [report.numbers_of_images(name, about, gathered.scores())],
    }


def _add_detected(folder: Path, names: Sequence[str], gathered: FrameScores) -> None:
    """Add what another network or detector found in the clips, as far as there are files."""
    files = [path for name in names if (path := folder / f"{name}.npz").is_file()]
    for path in files:
        for name, sides in (("embeddings", gathered.embeddings), ("points", gathered.detected)):
            pair = read_pair(path, name)
            if pair is not None:
                for side, values in zip(sides, pair, strict=True):
                    side.append(values)
    gathered.without_embeddings = f"{folder.name} holds no embeddings"


def _stored(data: Dataset) -> dict[str, Clip]:
    return {clip.id: clip for clip in data.clips()}


def _write_videos(data: Dataset, name: str, watched: Sequence[Watched], folder: Path) -> list[str]:
    """Side by side: the recorded clip and the video of its name."""
    names = []
    for w in watched:
        assert w.clip is not None
        clip = _stored(data)[w.clip.name]
        frames = padded(square_frames(w.path), clip.n_frames)
        names.append(f"{clip.id}.mp4")
        write_video(folder / names[-1], data, clip, {name: frames})
    return names
