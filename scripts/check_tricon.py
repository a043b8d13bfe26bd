"""Whether a generator hears words and sound and keeps to a style, judged by what is true of motion.

    python scripts/check_tricon.py WORK BUNDLE... -o OUT.json [--takes 40] [--generator tricon]

WORK is what motion_set.py made: dataset and strokes. What judges is trained on the training clips
and tried on the test clips; what is judged is gestured to new takes of the same four presenters, of
which only the speech is made. Intervals are of 95 %, by drawing takes anew 2000 times.

words     Where a word calls for a stroke (see `data_prep.phantom.gesture`), a classifier of strokes
          (principal components of 1.2 s of motion, logistic regression) looks at the generated
          motion at that time. Share of calls in which it sees the stroke that is called: with the
          own words, with those of another take of the same speaker, without words; and the
          difference of the first two. `accuracy` is the classifier's on strokes of true test
          motion, `usual` that of always naming the most frequent one.
sound     Beat consistency with the own sound, and the mean of that with the sound shifted in a
          circle by 1.3, 2.7 and 4.1 s; their difference.
identity  A classifier of speakers (spread and speed of each region over 64 frames, logistic
          regression) on motion in each of the four styles to the same speech, begun with the same
          pose. Share of windows whose style it names; by chance a quarter.
course    Pixels: the largest first step of a region, and the largest step in training. Mean speed
          of the active regions where windows meet (4 frames of 15 a second, every 30) over that
          elsewhere.
"""

import argparse
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import soxr
from numpy.typing import NDArray
from sklearn.decomposition import PCA
from sklearn.linear_model import LogisticRegression
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler

from angie.bundle import Bundle
from angie.generators.base import GestureGenerator
from angie.metrics.beats import consistency, usual_steps
from angie.motion.clips import MotionClip, read_clips
from angie.motion.statistics import MotionStatistics
from data_prep.dataset import Dataset
from data_prep.errors import call_script
from data_prep.phantom.make import Take, take
from data_prep.progress import progress
from data_prep.rates import FPS, SAMPLE_RATE
from data_prep.speech.features import Speech
from data_prep.speech.words import Word
from mraa.motion import Motion

BEFORE, AFTER, EVERY = 20, 10, 2
"""Frames of a stroke before and after its apex, and every so many of them."""

LEAST = 6
"""Strokes of a kind in the training clips, at least."""

WINDOW = 64
SHIFTS = (1.3, 2.7, 4.1)
FIRST = 500
"""Number of the first new take; the dataset has lower ones."""

BOOTSTRAPS = 2000


@dataclass
class Said:
    """A new take: who, and what is heard, said and called for."""

    who: str
    speech: Speech
    words: list[Word]
    calls: list[tuple[str, float]]  # strokes and their apex in seconds


def said(index: int, number: int, seed: int) -> Said:
    """The speech of a take and the strokes that its words call for."""
    shot: Take = take(index, number, seconds=30.0, seed=seed)
    samples = soxr.resample(shot.speech.samples, shot.speech.rate, SAMPLE_RATE)
    words = [Word(w.word, w.start, w.end) for w in shot.speech.words]
    calls = [(s.label, s.apex) for s in shot.strokes if s.called]
    return Said(shot.who.name, Speech(samples.astype(np.float32), words), words, calls)


def centred(motion: Motion, statistics: MotionStatistics) -> NDArray:
    """Motion (T, C) from its own median pose, in deviations of training."""
    vector = motion.vector()
    return ((vector - vector.median(dim=0).values) / statistics.pose_scale).numpy()


def stroke_window(motion: NDArray, apex: float) -> NDArray | None:
    """What classifies a stroke at a time: (n,), or None too near the ends."""
    at = round(apex * FPS)
    if not BEFORE <= at < len(motion) - AFTER:
        return None
    return motion[at - BEFORE : at + AFTER : EVERY].ravel()


def true_strokes(
    data: Dataset, clips: list[MotionClip], truth: Path, statistics: MotionStatistics
) -> tuple[NDArray, NDArray]:
    """Windows (n, d) of all strokes of clips, and their labels."""
    known = {clip.id: clip for clip in data.clips()}
    windows, labels = [], []
    for clip in clips:
        about, motion = known[clip.name], centred(clip.motion, statistics)
        with np.load(truth / f"{about.source}.npz") as file:
            for label, apex in zip(file["stroke_label"], file["stroke_apex"], strict=True):
                window = stroke_window(motion, float(apex) - about.start)
                if window is not None:
                    windows.append(window)
                    labels.append(str(label))
    return np.stack(windows), np.array(labels)


def classifier(parts: int | None = None) -> Pipeline:
    """Standardised features, some of their principal components, logistic regression."""
    steps: list[Any] = [StandardScaler(), *([PCA(parts, random_state=0)] if parts else [])]
    return make_pipeline(*steps, LogisticRegression(C=0.3, max_iter=2000))


def style_features(motion: Motion, statistics: MotionStatistics) -> NDArray:
    """How windows of 64 frames move: spread and speed of each channel of the shift, (n, 2 * 2K)."""
    vector = (motion.vector() / statistics.pose_scale).numpy()[:, : 2 * statistics.regions]
    parts = [vector[i : i + WINDOW] for i in range(0, len(vector) - WINDOW + 1, WINDOW // 2)]
    rows = [np.concatenate([p.std(0), np.abs(np.diff(p, axis=0)).mean(0)]) for p in parts]
    return np.log(np.array(rows) + 1e-3)


def interval(values: NDArray) -> dict[str, float]:
    """Mean of sums and counts (n, 2) a take, and its 95 % interval."""
    rng = np.random.default_rng(0)
    drawn = values[rng.integers(0, len(values), (BOOTSTRAPS, len(values)))].sum(1)
    low, high = np.quantile(drawn[:, 0] / np.maximum(drawn[:, 1], 1e-9), [0.025, 0.975])
    total = values.sum(0)
    names = ("mean", "low", "high")
    return dict(zip(names, (float(total[0] / total[1]), float(low), float(high)), strict=True))


def found(
    made: list[Motion], takes: list[Said], judge: Pipeline, stats: MotionStatistics
) -> NDArray:
    """Called strokes that are seen, and calls, (n, 2), in motions to takes."""
    known, counts = set(judge.classes_), np.zeros((len(takes), 2))
    for row, motion, one in zip(counts, made, takes, strict=True):
        moved = centred(motion, stats)
        for label, apex in one.calls:
            window = stroke_window(moved, apex)
            if window is not None and label in known:
                row += judge.predict(window[None])[0] == label, 1
    return counts


def judge_words(
    generator: GestureGenerator, takes: list[Said], judge: Pipeline, stats: MotionStatistics
) -> tuple[dict[str, Any], list[Motion]]:
    """Called strokes that are seen with own, other and no words; the motion of the own."""
    others = []
    for i, one in enumerate(takes):
        same = [k for k, other in enumerate(takes) if other.who == one.who and k != i]
        others.append(takes[min((k for k in same if k > i), default=same[0])].words)
    seen, own = {}, []
    for name, words in (
        ("own", [one.words for one in takes]), ("other", others), ("none", [[]] * len(takes))
    ):  # fmt: skip
        made = []
        for one, given in zip(takes, words, strict=True):
            start = Motion.from_vector(stats.rest_of(one.who)[None])
            speech = Speech(one.speech.samples, given)
            made.append(generator.generate(speech, start, one.speech.frames, speaker=one.who))
        seen[name] = found(made, takes, judge, stats)
        own = own or made
    apart = np.stack([seen["own"][:, 0] - seen["other"][:, 0], seen["own"][:, 1]], axis=1)
    scores = {name: interval(counts) for name, counts in seen.items()}
    return {**scores, "own over other": interval(apart), "calls": int(seen["own"][:, 1].sum())}, own


def judge_sound(
    made: list[Motion], takes: list[Said], train: list[MotionClip], stats: MotionStatistics
) -> dict[str, Any]:
    """Beat consistency with the own sound and with it shifted."""
    active = stats.active.numpy()

    def places(motion: Motion) -> NDArray:
        return motion.shift.double().numpy()[:, active]

    usual = usual_steps([places(clip.motion) for clip in train])
    scores = []
    for motion, one in zip(made, takes, strict=True):
        onsets, length = one.speech["onset_times"].astype(float), motion.frames / FPS
        row = [
            consistency([places(motion)], [np.sort((onsets + shift) % length)], usual, FPS).value
            for shift in (0.0, *SHIFTS)
        ]
        if None not in row:
            scores.append(row)
    table = np.array(scores, float)
    ones = np.ones(len(table))
    columns = {"own": table[:, 0], "shifted": table[:, 1:].mean(1)}
    columns["own over shifted"] = columns["own"] - columns["shifted"]
    return {name: interval(np.stack([values, ones], 1)) for name, values in columns.items()}


def judge_course(
    made: list[Motion], train: list[MotionClip], stats: MotionStatistics
) -> dict[str, float]:
    """How motion begins, and where its windows meet; pixels of a picture of 256."""

    def steps(motion: Motion) -> NDArray:
        return motion.shift.diff(dim=0).norm(dim=-1).numpy() * 128

    inside, outside = [], []
    for motion in made:
        moved = steps(motion)[:, stats.active.numpy()].mean(1)
        at = (np.arange(len(moved)) + 0.5) / FPS % 2.0
        met = (at < 4 / 15) & (np.arange(len(moved)) > FPS)
        inside.append(moved[met])
        outside.append(moved[~met])
    return {
        "first step": float(max(steps(motion)[0].max() for motion in made)),
        "largest of training": float(max(steps(clip.motion).max() for clip in train)),
        "seams": float(np.concatenate(inside).mean() / np.concatenate(outside).mean()),
    }


def judge_identity(
    generator: GestureGenerator, takes: list[Said], judge: Pipeline, stats: MotionStatistics
) -> dict[str, Any]:
    """Share of windows, in each style to the same speech, of which the style is named."""
    counts = np.zeros((len(takes), 2))
    named: dict[str, list[float]] = {name: [] for name in stats.speakers}
    for row, one in zip(counts, takes, strict=True):
        start = Motion.from_vector(stats.rest_of(one.who)[None])
        for name in stats.speakers:
            made = generator.generate(one.speech, start, one.speech.frames, style=name)
            right = judge.predict(style_features(made, stats)) == name
            row += right.sum(), len(right)
            named[name].append(float(right.mean()))
    return {"named": interval(counts), **{k: round(float(np.mean(v)), 3) for k, v in named.items()}}


def main() -> None:
    """Judge bundles."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("work", type=Path)
    parser.add_argument("bundles", type=Path, nargs="+")
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--takes", type=int, default=40)
    parser.add_argument("--generator", default="tricon")
    parser.add_argument("--seed", type=int, default=1, help="of the dataset's takes")
    options = parser.parse_args()
    data, first = Dataset(options.work / "set"), Bundle.open(options.bundles[0])
    stats = first.statistics()
    identity = first.motion_identity(data.digest)
    train, test = (read_clips(data, first.train / "motion", s, identity) for s in ("train", "test"))
    windows, labels = true_strokes(data, train, options.work / "truth", stats)
    kinds, numbers = np.unique(labels, return_counts=True)
    usual = set(kinds[numbers >= LEAST])
    kept = np.isin(labels, list(usual))
    strokes = classifier(60).fit(windows[kept], labels[kept])
    windows, labels = true_strokes(data, test, options.work / "truth", stats)
    right = strokes.predict(windows) == labels
    report: dict[str, Any] = {"strokes": {
        "kinds": len(usual), "training": int(kept.sum()), "test": len(labels),
        "accuracy": float(right.mean()), "usual": float((labels == kinds[numbers.argmax()]).mean()),
    }}  # fmt: skip
    rows = [style_features(clip.motion, stats) for clip in train]
    who = np.repeat([clip.speaker for clip in train], [len(r) for r in rows])
    styles = classifier().fit(np.concatenate(rows), who)
    hits = [styles.predict(style_features(clip.motion, stats)) == clip.speaker for clip in test]
    report["speakers"] = {"accuracy": float(np.concatenate(hits).mean())}
    print(json.dumps(report, indent=1), flush=True)
    takes = [said(i % 4, FIRST + i // 4, options.seed) for i in range(options.takes)]
    report["bundles"] = {}
    with progress("bundles", len(options.bundles), "bundles") as advance:
        for folder in options.bundles:
            generator = Bundle.open(folder).generator(options.generator)
            words, own = judge_words(generator, takes, strokes, stats)
            report["bundles"][str(folder)] = found_all = {
                "words": words, "sound": judge_sound(own, takes, train, stats),
                "identity": judge_identity(generator, takes[::4], styles, stats),
                "course": judge_course(own, train, stats),
            }  # fmt: skip
            print(folder, json.dumps(found_all, indent=1), flush=True)
            advance()
    options.output.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    call_script(main)
