"""Region motion of every clip of a dataset, measured by the frozen region estimator."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from data_prep.dataset import Clip, Dataset
from data_prep.errors import BadInput
from data_prep.files import whole_file
from data_prep.progress import progress, spread
from mraa.affine import encode_cholesky
from mraa.motion import Motion, read_motion, write_motion
from mraa.regions import RegionEstimator
from mraa.renderer import from_pixels


@torch.no_grad()
def measure_motion(estimator: RegionEstimator, frames: Iterator[Tensor]) -> Motion:
    """Region motion (T, K) of batches of frames (b, H, W, 3) uint8."""
    device = next(estimator.parameters()).device
    shifts, factors = [], []
    for batch in frames:
        regions = estimator(from_pixels(batch.to(device)))
        shifts.append(regions.shift.cpu())
        factors.append(encode_cholesky(regions.covariance).cpu())
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
    motion = measure_motion(estimator, _batches(dataset, clip, batch))
    with whole_file(folder / f"{clip.id}.npz", force=True) as part:
        write_motion(part, motion, identity)
    return True


def _batches(dataset: Dataset, clip: Clip, batch: int) -> Iterator[Tensor]:
    store = dataset.frames(clip)
    for start in range(0, len(store), batch):
        stop = min(start + batch, len(store))
        yield torch.from_numpy(np.stack([store[i] for i in range(start, stop)]))


def _is_done(path: Path, identity: str) -> bool:
    if not path.exists():
        return False
    try:
        read_motion(path, identity)
    except BadInput:  # of another estimator, or damaged: measured again
        return False
    return True
