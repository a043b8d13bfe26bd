"""Normalisation statistics of a motion dataset: scales, rest poses, ranges, active regions."""

import difflib
import json
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError
from torch import Tensor

from angie.motion.clips import MotionClip
from data_prep.errors import BadInput
from data_prep.speech.features import MFCC_COLUMNS
from data_prep.tensors import open_tensors, save_tensors
from mraa.motion import deltas, pack_covariance, pack_extents

BEAT_COLUMN = 41
"""Column of the onset features with the beat one-hot, which is never standardised."""

ONSET_LIMIT = 5.0
"""Standardised onset features are clamped to this."""

ACTIVE_LEAST, ACTIVE_MOST = 4, 10
"""Fewest and most active regions."""

ANCHORS = 256
"""Poses kept from calm moments of the training clips, at most."""

CALM = 0.1
"""Share of the training frames that count as calm."""


def known(speaker: str, speakers: Sequence[str]) -> str:
    """The name of a speaker, if it is one of these.

    Raises:
        BadInput: it is none.
    """
    if speaker in speakers:
        return speaker
    near = difflib.get_close_matches(speaker, speakers, n=1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    raise BadInput(f"{speaker}: not a speaker of this model (known: {', '.join(speakers)}){hint}")


@dataclass(frozen=True)
class MotionStatistics:
    """What training and generation must agree on, measured on the training clips.

    Channels are those of the motion vector: 2K of shift, then 3K of the Cholesky factor. The
    displacement of a pose is its difference from the speaker's rest pose; where several people are
    seen with one way of gesturing, from their own mean pose.

    Attributes:
        speakers: names, P of them, sorted.
        rest: (P, 5K) mean pose of each speaker.
        delta_scale: (5K,) standard deviation of relative motion. Deltas are divided by it and no
            mean is subtracted: a still person must be representable exactly.
        pose_scale: (5K,) standard deviation of the displacement.
        low: (5K,) 0.2th percentile of the displacement.
        high: (5K,) 99.8th percentile of the displacement.
        diagonal_low: (K, 2) 0.5th percentile of (l1, l3).
        diagonal_high: (K, 2) 99.5th percentile of (l1, l3).
        active: (K,) bool, regions that move more than the mean region, 4 to 10 of them.
        onset_mean: (426,) mean of the onset features.
        onset_scale: (426,) their standard deviation.
        mfcc_mean: (12,) mean of the cepstral coefficients.
        mfcc_scale: (12,) their standard deviation.
        pose_mean: (5K,) mean pose over all frames; this and what follows is empty in files that
            were written before it existed.
        pose_deviation: (5K,) standard deviation of the absolute pose.
        covariance_scale: (3K,) standard deviation of the change of C, as (c11, c12, c22).
        extent_mean: (7K,) mean of C (3K) and of A = U sqrt(S) (4K), for the naive scheme.
        extent_deviation: (7K,) their standard deviation.
        calm: (1,) 10th percentile of the activity of a frame.
        anchors: (n, 5K) displacements in calm frames, n up to 256.
    """

    speakers: tuple[str, ...]
    rest: Tensor
    delta_scale: Tensor
    pose_scale: Tensor
    low: Tensor
    high: Tensor
    diagonal_low: Tensor
    diagonal_high: Tensor
    active: Tensor
    onset_mean: Tensor
    onset_scale: Tensor
    mfcc_mean: Tensor
    mfcc_scale: Tensor
    pose_mean: Tensor = field(default_factory=lambda: torch.zeros(0))
    pose_deviation: Tensor = field(default_factory=lambda: torch.zeros(0))
    covariance_scale: Tensor = field(default_factory=lambda: torch.zeros(0))
    extent_mean: Tensor = field(default_factory=lambda: torch.zeros(0))
    extent_deviation: Tensor = field(default_factory=lambda: torch.zeros(0))
    calm: Tensor = field(default_factory=lambda: torch.zeros(0))
    anchors: Tensor = field(default_factory=lambda: torch.zeros(0, 0))

    @property
    def regions(self) -> int:
        """Number of regions K."""
        return self.active.shape[0]

    @property
    def has_extent(self) -> bool:
        """Whether there are Cholesky factors; joints have none and 2K channels."""
        return self.rest.shape[1] > 2 * self.regions

    def place_of(self, speaker: str) -> int:
        """Place of a speaker in `speakers`.

        Raises:
            BadInput: the speaker was not in the training set.
        """
        return self.speakers.index(known(speaker, self.speakers))

    def rest_of(self, speaker: str) -> Tensor:
        """Rest pose (5K,) of a speaker of the training set.

        Raises:
            BadInput: the speaker was not in the training set.
        """
        return self.rest[self.place_of(speaker)]

    def standard_onset(self, onset: Tensor) -> Tensor:
        """Standardise onset features (..., 426), clamped to +-5; the beat one-hot stays raw."""
        standard = (onset - self.onset_mean.to(onset)) / self.onset_scale.to(onset)
        standard = standard.clamp(-ONSET_LIMIT, ONSET_LIMIT)
        standard[..., BEAT_COLUMN] = onset[..., BEAT_COLUMN]
        return standard

    def standard_sound(self, name: str, rows: Tensor) -> Tensor:
        """Standardised rows of a feature of tokens; those of sound as it comes are so already."""
        return self.standard_onset(rows) if name == "onset" else rows

    def standard_mfcc(self, mfcc: Tensor) -> Tensor:
        """Standardise MFCC windows (..., 28, 12) per coefficient."""
        return (mfcc - self.mfcc_mean.to(mfcc)) / self.mfcc_scale.to(mfcc)

    def save(self, path: Path) -> None:
        """Write a safetensors file; the speakers' names are in its metadata."""
        tensors = {name: getattr(self, name).contiguous() for name in _TENSORS}
        save_tensors(path, tensors, {"format": "1", "speakers": json.dumps(self.speakers)})

    @classmethod
    def load(cls, path: Path) -> "MotionStatistics":
        """Read what `save` wrote.

        Raises:
            BadInput: missing, not a statistics file, or of a newer format.
        """
        try:
            with open_tensors(path) as file:
                about = file.metadata() or {}
                if about.get("format") != "1":
                    raise BadInput(f"{path}: unknown format of statistics; update the program")
                there = [name for name in _TENSORS if name not in _LATER or name in file.keys()]
                tensors = {name: file.get_tensor(name) for name in there}
        except (OSError, SafetensorError) as error:
            raise BadInput(f"{path}: not a statistics file ({error}); train again") from error
        return cls(speakers=tuple(json.loads(about["speakers"])), **tensors)


_TENSORS = tuple(entry.name for entry in fields(MotionStatistics) if entry.name != "speakers")
_LATER = (
    "pose_mean", "pose_deviation", "covariance_scale", "extent_mean", "extent_deviation", "calm",
    "anchors",
)  # fmt: skip


def _scale(values: np.ndarray, least: float) -> np.ndarray:
    return np.maximum(values.std(axis=0, dtype=np.float64), least)


def _means(poses: Sequence[np.ndarray], whose: Sequence[Any]) -> dict[Any, np.ndarray]:
    """Mean pose (5K,) over all frames of everyone, by what `whose` says of each clip."""
    frames: dict[Any, list[np.ndarray]] = {}
    for pose, who in zip(poses, whose, strict=True):
        frames.setdefault(who, []).append(pose)
    return {who: np.concatenate(own).mean(axis=0, dtype=np.float64) for who, own in frames.items()}


def _active_regions(relative: np.ndarray, regions: int) -> np.ndarray:
    energy = np.linalg.norm(relative[:, : 2 * regions].reshape(-1, regions, 2), axis=-1).mean(0)
    count = int((energy > energy.mean()).sum())
    count = min(max(count, ACTIVE_LEAST), ACTIVE_MOST, regions)
    active = np.zeros(regions, bool)
    active[np.argsort(-energy, kind="stable")[:count]] = True
    return active


def _diagonals(cholesky: np.ndarray, regions: int) -> np.ndarray:
    """0.5th and 99.5th percentile (2, K, 2) of (l1, l3) of factors (n, 3K); ones for points."""
    if not cholesky.shape[1]:
        return np.ones((2, regions, 2))
    return np.quantile(cholesky.reshape(-1, regions, 3)[..., ::2], [0.005, 0.995], axis=0)


def _covariance_scale(clips: Sequence[MotionClip]) -> np.ndarray:
    """Standard deviation (3K,) of the change of (c11, c12, c22); empty for points."""
    if not clips[0].motion.has_extent:
        return np.zeros(0)
    changes = [pack_covariance(clip.motion.covariance()).diff(dim=0) for clip in clips]
    return _scale(torch.cat(changes).numpy(), 1e-7)


def _extents(clips: Sequence[MotionClip]) -> dict[str, np.ndarray]:
    """Mean and standard deviation (7K,) of covariances and their roots; empty for points."""
    if not clips[0].motion.has_extent:
        return {"extent_mean": np.zeros(0), "extent_deviation": np.zeros(0)}
    extents = torch.cat([pack_extents(clip.motion.covariance()) for clip in clips]).numpy()
    return {
        "extent_mean": extents.mean(axis=0, dtype=np.float64),
        "extent_deviation": _scale(extents, 1e-7),
    }


def _calm(
    poses: Sequence[np.ndarray], displacement: np.ndarray, scale: np.ndarray
) -> dict[str, np.ndarray]:
    """Activity below which a frame is calm, and evenly spaced displacements of calm frames."""
    moved = [np.diff(pose, axis=0, prepend=pose[:1]) / scale for pose in poses]
    active = np.sqrt(np.square(np.concatenate(moved)).mean(axis=1))
    first = np.cumsum([0, *[len(pose) for pose in poses[:-1]]])
    inside = np.ones(len(active), bool)
    inside[first] = False  # a clip's first frame has no predecessor
    calm = float(np.quantile(active[inside], CALM)) if inside.any() else 0.0
    places = np.flatnonzero(inside & (active <= calm))
    places = places[np.linspace(0, len(places) - 1, min(ANCHORS, len(places))).astype(int)]
    return {"calm": np.array([calm]), "anchors": displacement[places]}


def measure(clips: Sequence[MotionClip]) -> MotionStatistics:
    """Measure the statistics of training clips.

    Standard deviations have a floor (1e-5 for deltas, 1e-4 for poses, both far below a pixel, and
    1e-3 for sound), so that a channel that never changes does not divide by zero.

    Args:
        clips: training clips with motion and features, at least one.

    Raises:
        BadInput: no clips.
    """
    if not clips:
        raise BadInput("dataset: no training clip has motion; run the motion stage")
    regions = clips[0].motion.regions
    poses = [clip.motion.vector().numpy() for clip in clips]
    relative = np.concatenate([deltas(torch.from_numpy(pose)).numpy()[1:] for pose in poses])
    speakers = tuple(sorted({clip.speaker for clip in clips}))
    means = _means(poses, [clip.speaker for clip in clips])
    rest = np.stack([means[speaker] for speaker in speakers])
    seen = [(clip.speaker, clip.person) for clip in clips]
    own = _means(poses, seen)
    displacement = np.concatenate([pose - own[who] for pose, who in zip(poses, seen, strict=True)])
    low, high = np.quantile(displacement, [0.002, 0.998], axis=0)
    together = np.concatenate(poses)
    diagonal_low, diagonal_high = _diagonals(together[:, 2 * regions :], regions)
    onset = np.concatenate([clip.speech["onset"] for clip in clips])
    mfcc = np.concatenate([clip.speech["mfcc"].reshape(-1, MFCC_COLUMNS) for clip in clips])
    arrays = {
        "rest": rest,
        "delta_scale": _scale(relative, 1e-5),
        "pose_scale": _scale(displacement, 1e-4),
        "low": low,
        "high": high,
        "diagonal_low": diagonal_low,
        "diagonal_high": diagonal_high,
        "onset_mean": onset.mean(axis=0, dtype=np.float64),
        "onset_scale": _scale(onset, 1e-3),
        "mfcc_mean": mfcc.mean(axis=0, dtype=np.float64),
        "mfcc_scale": _scale(mfcc, 1e-3),
        "pose_mean": together.mean(axis=0, dtype=np.float64),
        "pose_deviation": _scale(together, 1e-4),
        "covariance_scale": _covariance_scale(clips),
        **_extents(clips),
        **_calm(poses, displacement, _scale(relative, 1e-5)),
    }
    tensors = {name: torch.from_numpy(value.astype(np.float32)) for name, value in arrays.items()}
    active = torch.from_numpy(_active_regions(relative, regions))
    return MotionStatistics(speakers=speakers, active=active, **tensors)
