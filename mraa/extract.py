"""Region motion of every clip of a dataset, measured by the frozen region estimator."""

import itertools
from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from data_prep.dataset import Clip, Dataset
from data_prep.errors import BadInput
from data_prep.files import whole_file
from data_prep.processes import spread
from data_prep.progress import progress
from mraa.affine import encode_cholesky
from mraa.motion import Motion, read_motion, write_motion
from mraa.regions import RegionEstimator, Regions
from mraa.renderer import from_pixels


def estimate(
    estimator: RegionEstimator, frames: Iterable[NDArray[np.uint8]], batch: int = 16
) -> Iterator[Regions]:
    """Regions of frames, taken as they are needed.

    Args:
        estimator: in eval mode.
        frames: (H, W, 3) uint8 RGB each.
        batch: frames whose regions are estimated together.

    Yields:
        Regions (b, K) on the estimator's device, b at most `batch`.
    """
    device, rest = next(estimator.parameters()).device, iter(frames)
    while held := list(itertools.islice(rest, batch)):
        with torch.no_grad():  # left before the caller goes on
            found = estimator(from_pixels(torch.from_numpy(np.stack(held)).to(device)))
        yield Regions(found.shift, found.covariance, found.affine)  # heatmaps fill the memory


def measure_motion(
    estimator: RegionEstimator, frames: Iterable[NDArray[np.uint8]], batch: int = 16
) -> Motion:
    """Region motion (T, K) of frames on the CPU; arguments as `estimate`, at least one frame."""
    parts = [
        (regions.shift.cpu(), encode_cholesky(regions.covariance).cpu())
        for regions in estimate(estimator, frames, batch)
    ]
    shifts, factors = zip(*parts, strict=True)
    return Motion(torch.cat(shifts), torch.cat(factors))


def extract_dataset(
    dataset: Dataset,
    estimator: RegionEstimator,
    folder: Path,
    identity: str,
    batch: int = 16,
    jobs: int = 0,
) -> None:
    """Write `folder/<clip>.npz` for every clip; clips done by the same estimator are kept.

    Args:
        dataset: the clips.
        estimator: frozen, in eval mode.
        folder: where the motion goes; made if need be.
        identity: hash of the estimator, stored with the motion.
        batch: frames at a time.
        jobs: processes that measure on a CPU, which share its threads; below 2 this one does.

    Raises:
        BadInput: a process died of a clip.
    """
    folder.mkdir(parents=True, exist_ok=True)
    clips = dataset.clips()
    todo = [clip for clip in clips if not _is_done(folder / f"{clip.id}.npz", identity)]
    on_cpu = next(estimator.parameters()).device.type == "cpu"
    jobs = max(1, min(jobs, len(todo))) if on_cpu else 1
    threads = max(1, torch.get_num_threads() // jobs)
    work = partial(_measure, dataset, estimator, folder, identity, batch, threads)
    frames = sum(clip.n_frames for clip in clips)
    before = frames - sum(clip.n_frames for clip in todo)
    with progress("motion", frames, "frames", done=before) as advance:
        for clip, done in spread(work, todo, jobs):
            if done is None:
                raise BadInput(f"{dataset.path}: a process died of {clip.id}; take fewer --workers")
            advance(clip.n_frames)


def _measure(
    dataset: Dataset,
    estimator: RegionEstimator,
    folder: Path,
    identity: str,
    batch: int,
    threads: int,
    clip: Clip,
) -> bool:
    """Write the motion of a clip."""
    torch.set_num_threads(threads)
    store = dataset.frames(clip)
    motion = measure_motion(estimator, (store[i] for i in range(len(store))), batch)
    with whole_file(folder / f"{clip.id}.npz", force=True) as part:
        write_motion(part, motion, identity)
    return True


def _is_done(path: Path, identity: str) -> bool:
    if not path.exists():
        return False
    try:
        read_motion(path, identity)
    except BadInput:  # of another estimator, or damaged: measured again
        return False
    return True
