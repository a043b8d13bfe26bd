"""`angie teach`: where limbs are, from the truth of drawn people or from networks that see them."""

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from angie.config import Preset
from angie.evaluation.people import TWICE, enlarged
from angie.evaluation.space import truths
from angie.generators.stages import digest, plain
from data_prep.dataset import Clip, Dataset
from data_prep.errors import BadInput
from data_prep.files import check_apart, check_output, whole_file
from data_prep.progress import progress
from data_prep.speaker.people import (
    EARS,
    ELBOWS,
    MOUTH,
    NOSE,
    SEEN,
    SHOULDERS,
    WRISTS,
    People,
    Pose,
)
from data_prep.tensors import save_tensors
from mraa.renderer import Renderer
from mraa.training.renderer import load_initial
from mraa.training.run import RunConfig
from mraa.training.teach import MarkedPairs, Marks, Teaching, check_regions, teach

STRIDE = 5
"""Networks look at every so many frames of a clip."""

CROWN, CHIN = 3.6, -0.93
"""Crown and chin on the line from mouth to ears, in parts of that way: least squares over 80 frames
of 21 avatars, whose true joints are known; 9 and 6 pixels off where a face has 60."""

NECK = -0.04
"""The pit of the neck on the line from the middle of the shoulders to the mouth; likewise, 9 pixels
off."""

KNUCKLE = 9
"""Point of a hand."""

LEAST = 0.3
"""Visibility below which a joint is not learnt from."""


def joints_of(pose: Pose, hands: NDArray) -> tuple[NDArray, NDArray]:
    """Joints (12, 2), as `mraa.training.teach.JOINTS`, of a pose, and what each is worth (12,).

    The network knows no crown, chin and neck; they follow from ears, mouth and shoulders.

    Args:
        pose: as the network sees it.
        hands: (2, 2) middles of the right and the left hand.
    """

    def middle(ids: tuple[int, int]) -> tuple[NDArray, float]:
        return pose.points[list(ids)].mean(0), float(pose.visible[list(ids)].min())

    (ears, a), (mouth, b), (chest, c) = (middle(ids) for ids in (EARS, MOUTH, SHOULDERS))
    head = [
        (mouth + CROWN * (ears - mouth), min(a, b)),
        (pose.points[NOSE], float(pose.visible[NOSE])),
        (mouth + CHIN * (ears - mouth), min(a, b)),
        (chest + NECK * (mouth - chest), min(b, c)),
    ]
    arms = [
        (point, float(pose.visible[ids[side]]))
        for side in (0, 1)
        for ids, point in (
            *((ids, pose.points[ids[side]]) for ids in (SHOULDERS, ELBOWS, WRISTS)),
            (WRISTS, hands[side]),
        )
    ]
    points, visible = zip(*head, *arms, strict=True)
    sure = np.array(visible)
    return np.stack(points), np.where(sure < LEAST, 0.0, sure)


def seen_in(people: People, dataset: Dataset, clip: Clip) -> Marks | None:
    """Joints that networks see in every `STRIDE`-th frame of a clip; None if in none of them."""
    store, rows = dataset.frames(clip), []
    people.forget()
    for number in range(0, len(store), STRIDE):
        large = enlarged(store[number])
        pose = people.pose(large)
        if pose is None:
            continue
        hands = np.stack([_hand(people, large, pose, side) for side in (0, 1)])
        points, sure = joints_of(pose, hands)
        rows.append((number, (points + 0.5) / TWICE - 0.5, sure))
    if not rows:
        return None
    numbers, points, sure = zip(*rows, strict=True)
    return Marks(np.array(numbers), np.stack(points), np.stack(sure))


def _hand(people: People, large: NDArray, pose: Pose, side: int) -> NDArray:
    """Middle (x, y) of a hand: the middle finger's knuckle, or what the pose says of a lost one."""
    square = people.hand_squares(pose)[side]
    hand = None if square is None else people.hand(large, square)
    seen = hand is not None and hand.score > SEEN
    return hand.points[KNUCKLE] if hand and seen else people.hand_centre(pose.points, side)


def marks_by_networks(dataset: Dataset, models: Path) -> dict[str, Marks]:
    """Joints of the training clips as networks see them, by clip id.

    Raises:
        BadInput: a network is missing.
    """
    people, clips, found = People(models), dataset.clips("train"), {}
    with progress("joints", sum(clip.n_frames for clip in clips), "frames") as advance:
        for clip in clips:
            marks = seen_in(people, dataset, clip)
            if marks is not None:
                found[clip.id] = marks
            advance(clip.n_frames)
    return found


def marks_of_truth(dataset: Dataset, raw: Path) -> dict[str, Marks]:
    """True joints of drawn people, by clip id; `raw` holds a `.truth.npz` beside each video.

    Raises:
        BadInput: no clip has its truth there.
    """
    known = truths(dataset, raw)
    return {
        name: Marks(np.arange(len(t.joints)), t.joints, np.ones(t.joints.shape[:2]))
        for name, t in known.items()
    }


def teach_dataset(
    dataset: Path,
    output: Path,
    preset: Preset,
    *,
    truth: Path | None = None,
    models: Path | None = None,
    how: Teaching | None = None,
    seed: int = 0,
    run_config: RunConfig | None = None,
    resume: bool = False,
    force: bool = False,
) -> int:
    """Teach a renderer where limbs are, for `train_renderer.initial`.

    Args:
        dataset: folder that `angie prepare` made.
        output: the .safetensors to write; checkpoints lie in a folder `OUTPUT.train` beside it.
        preset: sizes of the renderer; its `train_renderer.initial` are the weights to begin with.
        truth: folder of the videos of drawn people with their truth.
        models: folder of the networks that see people; one of the two is given.
        how: steps, batches, rate.
        seed: of everything random.
        run_config: device, precision and so on.
        resume: go on with an interrupted teaching.
        force: replace the output.

    Returns:
        the number of clips that were learnt from.

    Raises:
        BadInput: an input that cannot be used.
    """
    check_output(output, force=force)
    check_apart(output, [dataset])
    check_regions(preset.renderer.regions)
    if (truth is None) == (models is None):
        raise BadInput("give --models, the networks that see people, or --truth of drawn ones")
    data = Dataset(dataset)
    torch.manual_seed(seed)
    renderer = Renderer(preset.renderer)
    if preset.train_renderer.initial:
        load_initial(renderer, Path(preset.train_renderer.initial))
    marks = marks_of_truth(data, truth) if truth else marks_by_networks(data, Path(str(models)))
    pairs = MarkedPairs(data, marks)
    folder, how = output.with_name(f"{output.name}.train"), how or Teaching()
    sizes = plain({"renderer": preset.renderer, "initial": preset.train_renderer.initial})
    teacher = "truth" if truth else "networks"
    identity = digest("teach", teacher, sizes, seed, data.digest, asdict(how))
    run = replace(run_config or RunConfig(), identity=identity)
    teach(renderer, pairs, folder, how, seed=seed, run_config=run, resume=resume)
    with whole_file(output, force=force) as part:
        save_tensors(part, {k: v.contiguous() for k, v in renderer.state_dict().items()})
    return len(pairs)
