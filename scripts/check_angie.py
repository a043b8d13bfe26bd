"""What the motion side of bundles has learnt: codes, use of the sound, calm in silence, long sound.

    python scripts/check_angie.py DATASET BUNDLE... -o OUT.json [--minutes 10]

Everything is measured on the test clips of DATASET, which no stage of a bundle has seen, of the
speakers that the bundle was trained on:

codes     Perplexity of each stream, against that of as many clusters (k-means of the deltas of 8
          frames, as many centres as codes, counted on the same test tokens): what a codebook can
          use of this data without knowing more than a token. Correlation of the reconstructed
          shifts with the true ones over windows of 96 frames, each from its true first frame:
          encoded by itself, and `correlation in use`, in the context that the GPT's codes have
          (`vq.context`; of clips, decoded in windows that blend linearly).
sound     Cross-entropy in nats per code with the own sound, with that of another clip of the same
          speaker, and of an order-2 model of the codes (`angie.generators.angie.report`).
beats     Beat consistency of the truth and of what is generated, with and without the refiner,
          from the truth's first pose and code pair, mean of three seeds; and `by chance`, the
          same motion against its sound shifted in a circle by 1.3, 2.7 and 4.1 s: many beats
          alone score high, what is above chance keeps time.
calm      10 s of a test clip's speech and 10 s of digital silence in one recording, from the
          clip's first pose: mean speed of the active regions in the silence over that in the
          speech, mean over speakers, clips and three seeds. `silence alone` takes 10 s of silence
          without speech before it; `real` is the same ratio of the recorded motion, pauses of a
          second or more (without their first half second) against the rest.
long      The test sound of one speaker and then of the others, joined up to 10 minutes and repeated
          only where there is less, gestured by the one in one run: the largest excess of a channel
          of the shift over the training range (displacement from the speaker's rest) in units of
          its width; the peak memory of a process that does that and of one that makes a
          minute, and how much of it came on top of the sound and its features; and the seams. At
          the borders of the GPT's windows, and of the decoder's and the refiner's, speed and its
          change must be distributed as at the other borders of tokens: two-sample
          Kolmogorov-Smirnov tests, their distance (the largest difference of the two cumulative
          distributions), p, and the ratio of the medians; `seam_p` is the smallest p times the
          number of tests (Bonferroni), and a seam shows if it is below 0.05. Six runs count, each
          begun a token later than the one before, so that every place of the speech is a border of
          decoder and refiner in one of them: in a single run borders may by chance lie in livelier
          speech than other tokens. Each run has its own seed; with one seed for all, the same
          chance would move all of them at one step. `one run` tests only the first run.
"""

import argparse
import json
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import stats
from scipy.cluster.vq import kmeans2, vq

from angie.bundle import Bundle
from angie.evaluation.space import onsets_within, points
from angie.generators.angie.channels import Channels
from angie.generators.angie.codes import STREAMS, correlation, patterns, perplexity, reconstruction
from angie.generators.angie.family import NAME, load_generator, load_vq
from angie.generators.angie.generate import AngieGenerator
from angie.generators.angie.report import audio_sensitivity
from angie.generators.angie.train import code_windows
from angie.metrics.beats import consistency, usual_steps
from angie.motion.clips import MotionClip, read_clips
from angie.motion.statistics import MotionStatistics
from angie.motion.windows import WINDOW, MotionWindows
from data_prep.dataset import Dataset
from data_prep.errors import BadInput, call_script
from data_prep.rates import FPS, FRAMES_PER_TOKEN, SAMPLE_RATE, SAMPLES_PER_FRAME
from data_prep.speech.features import Speech
from data_prep.speech.synchrony import steps
from mraa.motion import Motion

SEEDS = (0, 1, 2)
SHIFTS = (1.3, 2.7, 4.1)
"""Seconds by which sound is shifted to tell synchrony from chance."""

SPEECH = QUIET = 10
"""Seconds of speech and of silence after it."""

PAUSE, SETTLED = 1.0, 0.5
"""Seconds without words that make a pause, and of its beginning that do not count."""

HOP_TOKENS = {"linear": 6, "hann": 3}
"""Tokens from one window of the decoder and of the refiner to the next, by how they blend."""

RUNS = 6
"""Runs of long sound, each begun a token later: once or twice through the windows."""

WIDER = 0.1
"""Part of the training range by which motion may leave it."""


def pieces(windows: MotionWindows) -> NDArray:
    """Normalised deltas (n * 12, 8, 5K) of the tokens of windows."""
    channels = Channels.of(windows.statistics)
    values = channels.normalise(windows.choose(["poses"]).stack("poses", 0, len(windows)))
    return values.unflatten(1, (-1, FRAMES_PER_TOKEN)).flatten(0, 1).numpy()


def supported(train: NDArray, test: NDArray, codes: int) -> float:
    """Perplexity of the test tokens (m, 8, C) in `codes` clusters of the training ones."""
    flat, seen = (values.reshape(len(values), -1).astype(np.float64) for values in (train, test))
    centre = flat.mean(0)
    axes = np.linalg.svd(flat[::4] - centre, full_matrices=False)[2][:32]
    flat, seen = (flat - centre) @ axes.T, (seen - centre) @ axes.T
    centres, _ = kmeans2(flat, codes, iter=20, minit="points", seed=0)
    return perplexity(torch.from_numpy(vq(seen, centres)[0]))


def codes_of(bundle: Bundle, train: MotionWindows, test: MotionWindows) -> dict[str, Any]:
    """Reconstruction and use of the codes on test windows."""
    scores: dict[str, Any] = reconstruction(load_vq(bundle), test)
    scores["correlation in use"] = correlation_in_use(bundle, test)
    split, size = 2 * train.statistics.regions, bundle.settings(NAME).vq.codes
    seen, held = pieces(train), pieces(test)
    for name, part in zip(STREAMS, (slice(0, split), slice(split, None)), strict=True):
        most = supported(seen[..., part], held[..., part], size)
        scores[f"{name}_supported"] = most
        scores[f"{name}_share"] = scores[f"{name}_perplexity"] / most
    return scores


def correlation_in_use(bundle: Bundle, windows: MotionWindows) -> float:
    """Correlation of shifts over windows, encoded in the context that the GPT learns."""
    vq, channels = load_vq(bundle), Channels.of(windows.statistics, bundle.settings(NAME).vq.quant)
    poses = windows.choose(["poses"]).stack("poses", 0, len(windows))
    made = channels.integrate(patterns(vq, windows), poses[:, 1])
    split = 2 * windows.statistics.regions
    return correlation(made[..., :split], poses[:, 1:, :split])


def speed(motion: Motion, statistics: MotionStatistics) -> NDArray:
    """Mean speed (T,) of the active regions, units of the picture a second; frame 1 has 0."""
    return steps(points(motion)[:, statistics.active.numpy()]).mean(1) * FPS


def consistency_of(
    motions: list[Motion], clips: list[MotionClip], active: NDArray, usual: NDArray, shift: float
) -> float:
    """Beat consistency of motions with the sound of clips, shifted in a circle by seconds."""
    sounds = []
    for motion, clip in zip(motions, clips, strict=True):
        length = motion.frames / FPS
        sounds.append(np.sort((onsets_within(clip, motion.frames) + shift) % length))
    score = consistency([points(m)[:, active] for m in motions], sounds, usual, FPS)
    if score.value is None:
        raise BadInput(f"beat consistency: {score.reason}")
    return score.value


def beats(
    generator: AngieGenerator, train: list[MotionClip], clips: list[MotionClip]
) -> dict[str, dict[str, float]]:
    """Beat consistency and what of it is chance; of the truth, with and without the refiner."""
    active = generator.statistics.active.numpy()
    usual = usual_steps([points(clip.motion)[:, active] for clip in train])
    bare = replace(generator, config=replace(generator.config, refine=False))
    runs = {"truth": [[clip.motion for clip in clips]]}
    for name, one in (("refined", generator), ("without refiner", bare)):
        runs[name] = [[begun(one, clip, seed) for clip in clips] for seed in SEEDS]
    found = {}
    for name, seeds in runs.items():
        scores = {
            kind: [
                consistency_of(run, clips, active, usual, shift)
                for run in seeds
                for shift in shifts
            ]
            for kind, shifts in (("bc", (0.0,)), ("by chance", SHIFTS))
        }
        found[name] = {kind: float(np.mean(values)) for kind, values in scores.items()}
    return found


def begun(generator: AngieGenerator, clip: MotionClip, seed: int) -> Motion:
    """Motion to the sound of a clip, begun with its first pose and code pair."""
    return generator.generate(
        clip.speech, clip.motion[:1], clip.motion.frames, seed=seed, speaker=clip.speaker,
        seed_motion=clip.motion, greedy=None,
    )  # fmt: skip


def calm(
    generator: AngieGenerator, data: Dataset, clips: list[MotionClip], first: int = 3
) -> dict[str, float]:
    """Speed in silence over speed in speech, of what is generated and of what was recorded."""
    known = {clip.id: clip for clip in data.clips("test")}
    seen: dict[str, int] = {}
    made, quiet, loud = [], [], []
    silence = Speech(np.zeros(QUIET * SAMPLE_RATE, np.float32))
    for clip in clips:
        still = pauses(data, known[clip.name])
        moved = speed(clip.motion, generator.statistics)
        quiet.append(moved[1:][still[1:]])
        loud.append(moved[1:][~still[1:]])
        seen[clip.speaker] = seen.get(clip.speaker, 0) + 1
        if seen[clip.speaker] > first:
            continue
        sound = data.sound(known[clip.name])[: SPEECH * SAMPLE_RATE]
        border = len(sound) // SAMPLES_PER_FRAME
        speech = Speech(np.concatenate([sound, np.zeros(QUIET * SAMPLE_RATE, np.float32)]))
        for seed in SEEDS:
            how: dict[str, Any] = {"seed": seed, "speaker": clip.speaker, "greedy": None}
            motion = generator.generate(speech, clip.motion[:1], border + QUIET * FPS, **how)
            value = speed(motion, generator.statistics)
            alone = generator.generate(silence, clip.motion[:1], QUIET * FPS, **how)
            rest = speed(alone, generator.statistics)[1:].mean()
            made.append((value[border:].mean(), value[1:border].mean(), value[-50:].mean(), rest))
    table = np.array(made)
    pause = np.concatenate(quiet)
    return {
        "ratio": float(table[:, 0].mean() / table[:, 1].mean()),
        "worst": float((table[:, 0] / table[:, 1]).max()),
        "last two seconds": float(table[:, 2].mean() / table[:, 1].mean()),
        "silence alone": float(table[:, 3].mean() / table[:, 1].mean()),
        "real": float(pause.mean() / np.concatenate(loud).mean()) if len(pause) else float("nan"),
        "recordings": len(made),
    }


def pauses(data: Dataset, clip: Any) -> NDArray:
    """Frames (T,) bool inside a pause of the words."""
    still = np.zeros(clip.n_frames, bool)
    now = 0.0
    for word in [*(data.words(clip) or []), None]:
        until = clip.n_frames / FPS if word is None else word.start
        if until - now >= PAUSE:
            still[round((now + SETTLED) * FPS) : round(until * FPS)] = True
        now = now if word is None else word.end
    return still


def long_sound(data: Dataset, clips: list[MotionClip], minutes: float, later: int = 0) -> Speech:
    """Features of the sound of clips, joined, begun some tokens later and repeated to a length."""
    known = {clip.id: clip for clip in data.clips("test")}
    sound = np.concatenate([data.sound(known[clip.name]) for clip in clips])
    sound = np.roll(sound, -later * FRAMES_PER_TOKEN * SAMPLES_PER_FRAME)
    wanted = int(minutes * 60 * SAMPLE_RATE) // SAMPLES_PER_FRAME * SAMPLES_PER_FRAME
    return Speech(np.resize(sound, wanted))


def borders(generator: AngieGenerator, frames: int) -> dict[str, NDArray]:
    """Frames at which one window becomes the next in long sound, by what has windows.

    Of the GPT these are the first frames of codes that are the first of a new window; a window
    that slides has none. Of decoder and refiner, where both windows weigh the same (linear), or
    where one begins (hann).
    """
    assert generator.gpt is not None
    block, blend = generator.gpt.config.block, generator.config.blend
    kept = generator.config.window.kept(block)
    last = frames // FRAMES_PER_TOKEN
    steps_of = np.arange(block + 1, last, block - kept + 1) if kept < block else np.zeros(0, int)
    if blend == "ahead":  # windows begin with every token, and there is nothing to compare with
        return {"gpt": steps_of * FRAMES_PER_TOKEN}
    hop = HOP_TOKENS[blend] * FRAMES_PER_TOKEN
    first = 3 * hop // 2 if blend == "linear" else WINDOW
    return {"gpt": steps_of * FRAMES_PER_TOKEN, "refiner": np.arange(first, frames - WINDOW, hop)}


def generate_long(
    dataset: Path, bundle: Path, names: list[str], minutes: float, later: int, output: Path
) -> tuple[float, float]:
    """Write the motion (T, 5K) for long sound of some test clips, begun some tokens later.

    That number is the seed, too.

    Returns:
        Peak memory in MB of the process, and how far generation rose above what it held when
        it began (Linux).
    """
    torch.set_num_threads(1)
    data, opened = Dataset(dataset), Bundle.open(bundle)
    motions = opened.train / "motion"
    known = {clip.name: clip for clip in read_clips(data, motions, "test")}
    clips = [known[name] for name in names]
    speech = long_sound(data, clips, minutes, later)
    frames = round(minutes * 60 * FPS)
    before = resident("VmHWM")
    held = resident("VmRSS")
    Path("/proc/self/clear_refs").write_text("5")  # the peak counts from here
    generator, start = load_generator(opened), clips[0].motion[:1]
    motion = generator.generate(
        speech, start, frames, seed=later, speaker=clips[0].speaker, greedy=None
    )
    np.save(output, motion.vector().numpy())
    during = resident("VmHWM")
    return max(before, during), during - held


def resident(name: str) -> float:
    """VmRSS, memory held now, or VmHWM, its peak, in MB; a child's ru_maxrss has its parent's."""
    status = Path("/proc/self/status").read_text()
    return int(status.split(f"{name}:")[1].split()[0]) / 1024


def long(
    generator: AngieGenerator, data: Dataset, bundle: Path, train: list[MotionClip],
    test: list[MotionClip], minutes: float,
) -> dict[str, Any]:  # fmt: skip
    """Range, memory and seams of one long run."""
    statistics, speaker = generator.statistics, test[0].speaker
    ordered = sorted(test, key=lambda clip: clip.speaker != speaker)  # the speaker's own first
    lengths = [(1.0, 0), *((minutes, later) for later in range(RUNS))]
    with TemporaryDirectory() as folder, get_context("spawn").Pool(1, maxtasksperchild=1) as pool:
        files = [Path(folder) / f"{i}.npy" for i in range(len(lengths))]
        jobs = [
            (data.path, bundle, [clip.name for clip in ordered], *length, file)
            for length, file in zip(lengths, files, strict=True)
        ]
        peak = pool.starmap(generate_long, jobs, chunksize=1)[:2]
        runs = [Motion.from_vector(torch.from_numpy(np.load(file))) for file in files[1:]]
    motion = runs[0]
    split = 2 * statistics.regions
    displaced = [c.motion.vector() - statistics.rest_of(c.speaker) for c in train]
    low = torch.stack([d.amin(0) for d in displaced]).amin(0)
    high = torch.stack([d.amax(0) for d in displaced]).amax(0)
    made = motion.vector() - statistics.rest_of(speaker)
    over = torch.maximum(made - high, low - made).amax(0) / (high - low)
    moved = speed(motion, statistics)
    result: dict[str, Any] = {
        "frames": motion.frames,
        "seconds before the sound repeats": sum(c.motion.frames for c in test) / FPS,
        "excess_shift": float(over[:split].max()),
        "excess_cholesky": float(over[split:].max()),
        "within": bool(over[:split].max() <= WIDER),
        "memory_mb": [whole for whole, _ in peak],
        "memory of generation_mb": [own for _, own in peak],
        "first and last minute's speed": [float(moved[:1500].mean()), float(moved[-1500:].mean())],
    }
    speeds = [speed(run, statistics) for run in runs]
    return result | seams(generator, speeds) | {"one run": seams(generator, speeds[:1])}


def seams(generator: AngieGenerator, speeds: list[NDArray]) -> dict[str, Any]:
    """Values of p of the tests on speeds (T,) and their changes at borders of windows."""
    changes = [np.abs(np.diff(moved, prepend=moved[0])) for moved in speeds]
    frames = len(speeds[0])
    tokens = np.arange(2 * FRAMES_PER_TOKEN, frames, FRAMES_PER_TOKEN)
    found: dict[str, Any] = {}
    for name, frames_of in borders(generator, frames).items():
        if len(frames_of):
            others = np.setdiff1d(tokens, frames_of)
            for kind, runs in (("speed", speeds), ("change", changes)):
                here, there = (
                    np.concatenate([values[at] for values in runs]) for at in (frames_of, others)
                )
                apart = stats.ks_2samp(here, there)
                found[f"{name}_{kind}_p"] = float(apart.pvalue)
                found[f"{name}_{kind}_distance"] = float(apart.statistic)
                found[f"{name}_{kind}_median_ratio"] = float(np.median(here) / np.median(there))
    tests = [value for name, value in found.items() if name.endswith("_p")]
    return found | {"seam_p": min(1.0, len(tests) * min(tests)) if tests else None}


def check(data: Dataset, folder: Path, minutes: float) -> dict[str, Any]:
    """Everything about one bundle."""
    bundle = Bundle.open(folder)
    statistics, generator = bundle.statistics(), load_generator(bundle)
    identity = bundle.motion_identity(data.digest)
    train, test = (
        [c for c in read_clips(data, bundle.train / "motion", split, identity)
         if c.speaker in statistics.speakers]
        for split in ("train", "test")
    )  # fmt: skip
    windows, held_out = (MotionWindows(clips, statistics) for clips in (train, test))
    assert generator.gpt is not None
    extractor: Any = generator.vq
    found = audio_sensitivity(
        generator.gpt, code_windows(extractor, windows), code_windows(extractor, held_out)
    )
    result = {
        "speakers": statistics.speakers,
        "training_minutes": sum(c.motion.frames for c in train) / FPS / 60,
        "test_minutes": sum(c.motion.frames for c in test) / FPS / 60,
        "codes": codes_of(bundle, windows, held_out),
        "audio_sensitivity": found.as_dict() if found is not None else None,
        "beats": beats(generator, train, test),
        "calm": calm(generator, data, test),
    }
    if minutes:
        result["long"] = long(generator, data, folder, train, test, minutes)
    return result


def main() -> None:
    """Check bundles one after the other; the file grows with each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset", type=Path)
    parser.add_argument("bundles", type=Path, nargs="+")
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--minutes", type=float, default=10.0, help="of long sound; 0 for none")
    given = parser.parse_args()
    data = Dataset(given.dataset)
    found: dict[str, Any] = {}
    for folder in given.bundles:
        found[folder.name] = check(data, folder, given.minutes)
        print(folder.name, json.dumps(found[folder.name], indent=1), flush=True)
        given.output.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    call_script(main)
