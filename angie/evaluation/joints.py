"""The phantom's true joints in the frames of a dataset, and reading joints from regions."""

import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_prep.dataset import Clip, Dataset
from data_prep.errors import BadInput
from data_prep.rates import FPS, IMAGE_SIZE

RIDGE = 1e-3
"""Weight of the squared coefficients for each frame, inputs standardised."""


def true_joints(dataset: Dataset, raw: Path) -> dict[str, NDArray]:
    """Joints (T, J, 2) of clips in pixels of their frames, by clip id.

    Args:
        dataset: prepared from videos of the phantom speaker.
        raw: folder that `angie phantom` wrote, with a `.truth.npz` beside each video.

    Raises:
        BadInput: no clip of the dataset has its truth there.
    """
    files = {path.name: path for path in sorted(Path(raw).rglob("*.truth.npz"))}
    sources = {source["name"]: source for source in dataset.manifest["sources"]}
    found = {}
    for clip in dataset.clips():
        source = sources.get(clip.source)
        name = "" if source is None else f"{Path(source['file']).stem}.truth.npz"
        if source is not None and name in files:
            joints = _joints_of(files[name], clip, source)
            if joints is not None:
                found[clip.id] = joints
    if not found:
        raise BadInput(f"{raw}: holds the truth (*.truth.npz) of no clip of {dataset.path}")
    return found


def _joints_of(path: Path, clip: Clip, source: dict[str, Any]) -> NDArray | None:
    """Joints of one clip in pixels of its frames; None where the truth does not reach."""
    try:
        with np.load(path, allow_pickle=False) as truth:
            joints = truth["joints"].astype(np.float64)
    except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise BadInput(f"{path}: no truth of the phantom speaker ({error})") from error
    first = round(clip.start * FPS)
    crops = [s["crop"] for s in source["spans"] if s["first"] <= first < s["stop"]]
    crop = (crops[0] if crops else None) or source["crop"]
    part = joints[first : first + clip.n_frames]
    if crop is None or len(part) < clip.n_frames:
        return None
    return (part - [crop["x"], crop["y"]]) * (IMAGE_SIZE / crop["size"])


JointReader = Callable[[NDArray], NDArray]
"""Gives joints (T, J, 2) in pixels of motion vectors (T, C)."""


def fit_reader(vectors: NDArray, joints: NDArray) -> JointReader:
    """Fit a ridge regression of joints (n, J, 2) on motion vectors (n, C) of training frames."""
    from sklearn.linear_model import Ridge  # slow to import
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    model = make_pipeline(StandardScaler(), Ridge(RIDGE * len(vectors)))
    model.fit(vectors, joints.reshape(len(joints), -1))
    return lambda vectors: model.predict(vectors).reshape(len(vectors), -1, 2)
