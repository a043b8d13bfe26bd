"""Scores of a row: every motion metric for each of its runs, then mean and interval over runs."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from angie.evaluation.definitions import PIXEL
from angie.evaluation.rows import Performance
from angie.evaluation.space import RegionSpace, points
from angie.metrics import beats, diversity, frechet, truth
from angie.metrics import diversity as speed
from angie.metrics.autoencoder import MotionAutoencoder, MotionScale, encode_windows, windows
from angie.metrics.score import Score
from data_prep.rates import FPS
from mraa.motion import Motion

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Windows:
    """Windows of motion as FGD and diversity see them: raw (n, L D), features, clip of each."""

    raw: NDArray
    features: NDArray
    clips: NDArray


@dataclass(frozen=True)
class Judge:
    """What performances are scored against.

    Attributes:
        active: (K,) bool, the regions that gesture.
        usual: (A,) their mean step in the training clips.
        scale: how motion is standardised for the auto-encoder.
        model: the auto-encoder; None where there are too few training windows.
        real: true motion (T, K, 2) of the test clips.
        speakers: who speaks in each.
        windows: those of the true motion.
        pixel: pixels of one unit of the motion; None where that is not known.
        fps: frames a second of all motion.
    """

    active: NDArray
    usual: NDArray
    scale: MotionScale
    model: MotionAutoencoder | None
    real: list[NDArray]
    speakers: list[str]
    windows: Windows
    pixel: float | None = PIXEL
    fps: float = FPS

    def only(self, speaker: str) -> "Judge":
        """The judge of one speaker's test clips; what is usual stays that of all."""
        kept = np.array([name == speaker for name in self.speakers])
        mine = kept[self.windows.clips]
        own = Windows(self.windows.raw[mine], self.windows.features[mine], self.windows.clips[mine])
        real = [clip for clip, keep in zip(self.real, kept, strict=True) if keep]
        return replace(self, real=real, speakers=[speaker] * len(real), windows=own)


def make_judge(
    space: RegionSpace, model: MotionAutoencoder | None, scale: MotionScale | None = None
) -> Judge:
    """The judge of a space; `scale` is that of a stored auto-encoder."""
    scale = scale or space.scale
    speakers = [clip.speaker for clip in space.test]
    cut = cut_windows([clip.motion for clip in space.test], speakers, scale, model)
    real = [points(clip.motion) for clip in space.test]
    return Judge(space.active, space.usual, scale, model, real, speakers, cut, space.pixel)


def cut_windows(
    motions: Sequence[Motion],
    speakers: Sequence[str | None],
    scale: MotionScale,
    model: MotionAutoencoder | None,
) -> Windows:
    """Windows of clips; an unknown speaker's rest pose is the clip's mean pose."""
    cut = []
    for motion, speaker in zip(motions, speakers, strict=True):
        vector = motion.vector().numpy()
        if speaker is None:
            standard = ((vector - vector.mean(0)) / scale.scale).astype(np.float32)
        else:
            standard = scale.standard(vector, speaker)
        cut.append(windows([standard]))
    clips = np.repeat(np.arange(len(cut)), [len(part) for part in cut])
    whole = np.concatenate(cut) if cut else np.zeros((0, 1, 1), np.float32)
    features = encode_windows(model, whole) if model is not None else np.zeros((0, 1))
    return Windows(whole.reshape(len(whole), math.prod(whole.shape[1:])), features, clips)


def score_motion(run: Sequence[Performance], judge: Judge, seed: int = 0) -> dict[str, Score]:
    """All scores of `definitions.MOTION` for one run."""
    own = cut_windows([p.motion for p in run], [p.speaker for p in run], judge.scale, judge.model)
    moved = [points(p.motion) for p in run]
    scores = _window_scores(own, judge, seed) | _beat_scores(run, moved, judge)
    real = [points(p.truth) for p in run if p.truth is not None]
    known = [m for m, p in zip(moved, run, strict=True) if p.truth is not None]
    active = judge.active
    return scores | {
        "hellinger": speed.hellinger(judge.real, moved, judge.fps),
        "hellinger_active": speed.hellinger(
            [clip[:, active] for clip in judge.real], [clip[:, active] for clip in moved], judge.fps
        ),
        "acceleration": speed.acceleration(moved, judge.fps),
        "jerk": speed.jerk(moved, judge.fps),
        **_truth_scores(real, known, judge),
    }


def _window_scores(own: Windows, judge: Judge, seed: int) -> dict[str, Score]:
    real = judge.windows
    scores = {
        "fgd_raw": frechet.raw_distance(real.raw, own.raw),
        "diversity_raw": diversity.pairwise(own.raw, seed),
    }
    keys = ("fgd", "diversity", "diversity_ha2g", "diversity_pairs")
    if judge.model is None:
        reason = "no auto-encoder: the training clips have fewer than two windows"
        return scores | {key: Score.missing(reason) for key in keys}
    return scores | {
        "fgd": frechet.feature_distance(real.features, own.features),
        "diversity": diversity.across_clips(own.features, own.clips, seed),
        "diversity_ha2g": diversity.shuffled(own.features, seed),
        "diversity_pairs": diversity.pairwise(own.features, seed),
    }


def _gestures(moved: Sequence[NDArray], judge: Judge) -> list[NDArray]:
    return [clip[:, judge.active] for clip in moved]


def _beat_scores(
    run: Sequence[Performance], moved: Sequence[NDArray], judge: Judge
) -> dict[str, Score]:
    gestures, onsets = _gestures(moved, judge), [p.onsets for p in run]
    return {
        "bc": beats.consistency(gestures, onsets, judge.usual, judge.fps),
        "pmb": beats.matched(gestures, onsets, judge.fps),
        "align_aist": beats.align(gestures, onsets, judge.fps, "aist"),
        "align_bailando": beats.align(gestures, onsets, judge.fps, "bailando"),
    }


def matched_curve(run: Sequence[Performance], judge: Judge) -> dict[float, Score]:
    """PMB of one run over its threshold."""
    gestures = _gestures([points(p.motion) for p in run], judge)
    return beats.matched_curve(gestures, [p.onsets for p in run], judge.fps)


def _truth_scores(real: list[NDArray], made: list[NDArray], judge: Judge) -> dict[str, Score]:
    if not real:
        reason = "what was recorded with this sound is not known"
        keys = ("maje", "maje_px", "mad", "mad_px", "cca_global", "cca")
        return {key: Score.missing(reason) for key in keys}
    apart, accelerated = truth.maje(real, made), truth.mad(real, made, judge.fps)
    return {
        "maje": _times(apart, 1000),
        "maje_px": _times(apart, judge.pixel),
        "mad": _times(accelerated, 1000),
        "mad_px": _times(accelerated, judge.pixel),
        "cca_global": truth.global_cca(real, made),
        "cca": truth.cca(real, made),
    }


def _times(score: Score, factor: float | None) -> Score:
    if factor is None:
        return Score.missing("joints have a unit of their own, whose pixels are not known")
    if score.value is None:
        return score
    return Score(score.value * factor, counts=score.counts, warning=score.warning)


@dataclass(frozen=True)
class Summary:
    """A score over the runs of a row.

    Attributes:
        mean: over runs; None where any run has no value.
        interval: half of the 95 % confidence interval of the mean over runs (Student's t); None
            for one run.
        reason: why there is no mean.
        runs: the score of every run.
    """

    mean: float | None
    interval: float | None
    reason: str
    runs: list[Score]

    @property
    def warning(self) -> str:
        """The first run's warning."""
        return next((score.warning for score in self.runs if score.warning), "")

    def as_dict(self) -> dict[str, Any]:
        """Plain values for a report."""
        return asdict(self)


def summarise(scores: Sequence[Score]) -> Summary:
    """Mean and interval of one score over runs, at least one."""
    values = [score.value for score in scores if score.value is not None]
    missing = [score.reason for score in scores if score.value is None]
    if missing:
        where = "" if len(missing) == len(scores) else f"in {len(missing)} of {len(scores)} runs: "
        return Summary(None, None, where + missing[0], list(scores))
    if len(values) == 1:
        return Summary(values[0], None, "", list(scores))
    quantile = stats.t.ppf((1 + CONFIDENCE) / 2, len(values) - 1)
    half = float(quantile * np.std(values, ddof=1) / math.sqrt(len(values)))
    return Summary(float(np.mean(values)), half, "", list(scores))


def summarise_runs(runs: Sequence[dict[str, Score]]) -> dict[str, Summary]:
    """Every score of the runs of a row, by key."""
    return {key: summarise([run[key] for run in runs]) for key in runs[0]}
