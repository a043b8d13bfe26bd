"""Sound to motion as arrays, without a photo: joints or regions."""

from pathlib import Path
from typing import Any

import numpy as np

from angie.motion.keypoints import read_points, resample
from angie.motion.statistics import MotionStatistics
from angie.pipeline import GesturePipeline
from angie.style import check_style
from data_prep.errors import BadInput, check_seed
from data_prep.files import check_apart, whole_file
from data_prep.progress import console
from data_prep.rates import FPS
from mraa.motion import Motion, read_motion


def start_pose(
    statistics: MotionStatistics, speaker: str | None, path: Path | None = None
) -> Motion:
    """The pose to begin with: the first frame of a file of motion, or a speaker's rest pose.

    Args:
        statistics: of the model.
        speaker: a speaker of the training set; None is the first.
        path: joints (.npy, .npz) or region motion (.npz), as the model has.

    Raises:
        BadInput: an unknown speaker, or motion of another kind or number of points.
    """
    if path is None:
        rest = statistics.rest[statistics.place_of(speaker or statistics.speakers[0])]
        if statistics.has_extent:
            return Motion.from_vector(rest[None])
        return Motion.of_points(rest.unflatten(-1, (-1, 2))[None])
    if statistics.has_extent:
        motion = read_motion(path)[:1]
    else:
        first = read_points(path)[:1].astype(np.float32)
        motion = Motion.of_points(statistics.rest.new_tensor(first))
    if motion.regions != statistics.regions:
        raise BadInput(f"{path}: has {motion.regions} points, the model {statistics.regions}")
    return motion


def gestures(
    pipeline: GesturePipeline,
    sound_path: Path,
    output: Path,
    *,
    start: Path | None = None,
    speaker: str | None = None,
    style: str | None = None,
    words: Path | None = None,
    fps: float = FPS,
    seed: int = 0,
    greedy: bool = False,
    force: bool = False,
) -> int:
    """Generate motion for a recording and write it as arrays.

    Args:
        pipeline: of a model of joints or of regions.
        sound_path: any recording.
        output: .npz: `points` (T, J, 2) and `fps` of joints; of regions `shift` (T, K, 2),
            `cholesky` (T, K, 3) and `fps`. A name that ends in .npy gets the joints alone.
        start: motion whose first frame is the start pose; None is the rest pose of `speaker`,
            or of the first speaker.
        speaker: a speaker of the training set, who gestures: in their style, and in long motion
            around their rest pose.
        style: a training speaker of a joint model, whose style alone is taken, whoever gestures;
            None takes that of `speaker`, or of anyone.
        words: transcript of the recording, for a generator that reads words.
        fps: frames a second wanted; motion of regions has 25.
        seed: of the gestures.
        greedy: always the likeliest gesture; else gestures are sampled. Both whatever method of
            sampling the bundle has, as in `angie.pipeline`.
        force: replace an existing output.

    Returns:
        Frames written.

    Raises:
        BadInput: an input that cannot be used; nothing is left behind.
    """
    check_apart(output, [path for path in (sound_path, start, words) if path])
    bundle = pipeline.bundle
    points = bundle.preset.points
    if output.suffix not in (".npz", ".npy") or (output.suffix == ".npy" and not points):
        raise BadInput(f"{output}: must end in .npz{' or .npy' if points else ''}")
    if fps != FPS and not points:
        raise BadInput(f"--fps {fps:g}: motion of regions has {FPS} frames a second")
    check_seed(seed)
    check_style(bundle, style, pipeline.name)
    generator = pipeline.generator
    with whole_file(output, force=force) as part:
        speech = pipeline.speech(sound_path, words)
        for note in pipeline.notes(speech):
            console.print(f"angie: {note}", highlight=False, markup=False, soft_wrap=True)
        pose = start_pose(pipeline.statistics, speaker, start)
        motion = generator.generate(
            speech, pose, speech.frames, seed=seed, speaker=speaker, style=style, greedy=greedy
        )
        arrays: dict[str, Any] = {"fps": np.array(float(fps))}
        if points:
            made = resample(motion.shift.numpy().astype(np.float64), FPS, fps)
            arrays["points"] = made.astype(np.float32)
        else:
            arrays.update(shift=motion.shift.numpy(), cholesky=motion.cholesky.numpy())
        with part.open("wb") as file:
            if output.suffix == ".npy":
                np.save(file, arrays["points"])
            else:
                np.savez(file, **arrays)
    return len(arrays["points"]) if points else speech.frames
