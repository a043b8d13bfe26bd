"""Training of TriCon: its windows, its losses, and the distance by which weights are chosen."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import smooth_l1_loss

from angie.generators.base import resample
from angie.generators.stages import StageContext, Trained
from angie.generators.tricon.model import Critic, Made, TriCon, TriConConfig, seeded
from angie.generators.tricon.words import KnownWords, words_of_frames
from angie.metrics.autoencoder import (
    AutoencoderTraining,
    MotionAutoencoder,
    encode_windows,
    train_autoencoder,
)
from angie.metrics.frechet import feature_distance
from angie.motion.clips import MotionClip
from data_prep.errors import BadInput
from data_prep.rates import FPS, SAMPLE_RATE
from mraa.training.checkpoint import Schedule
from mraa.training.run import Run

LOG = 1e-8
"""Added to probabilities whose logarithm is taken."""

PAPER = Schedule(rate=5e-4, batch=128, epochs=100, clip=1e9)
"""Gradients are not clipped."""

HUBER, STYLE = 0.1, 0.05
"""Errors below which the losses of poses and of styles are squares."""


@dataclass(frozen=True)
class TriConTraining:
    """Training; the defaults are the paper's.

    Attributes:
        schedule: Adam 5e-4, batch 128, 100 epochs.
        critic_rate: learning rate of the critic, as a part of the generator's.
        quiet: part of the steps before the critic comes in (10 epochs of 100).
        huber: weight of the error of poses.
        adversarial: weight of the critic's word.
        style: weight of the loss that keeps styles apart.
        divergence: weight of the divergence of styles from a standard Gaussian.
        stride: frames from one training window to the next, at the model's rate.
        least_words: in a training window, of clips that have words.
        drop_plain: part of the windows, those nearest to the mean pose, that are left out.
        drop_still: part of them, those whose active points move least, that are left out.
        word_dropout: part of the windows whose words are taken away, so that the model learns to
            do without; not in the paper.
        checks: evenly spaced evaluations by the distance of held-out windows (FGD).
        patience: evaluations without improvement after which training stops; 0 for never.
        judge_steps: most training steps of the network of that distance.
        vectors: text file of word vectors, for `encoder=vectors`.
    """

    schedule: Schedule = field(default_factory=lambda: PAPER)
    critic_rate: float = 0.2
    quiet: float = 0.1
    huber: float = 500.0
    adversarial: float = 5.0
    style: float = 0.05
    divergence: float = 0.1
    stride: int = 10
    least_words: int = 2
    drop_plain: float = 0.05
    drop_still: float = 0.01
    word_dropout: float = 0.0
    checks: int = 100
    patience: int = 0
    judge_steps: int = 3000
    vectors: str = ""

    def __post_init__(self) -> None:
        weights = self.huber, self.adversarial, self.style, self.divergence, self.critic_rate
        shares = self.quiet, self.drop_plain, self.drop_still, self.word_dropout
        if min(weights) < 0 or not all(0 <= share < 1 for share in shares):
            raise ValueError("weights must not be negative; quiet and drops are parts below 1")
        if min(self.stride, self.checks) < 1 or min(self.patience, self.least_words) < 0:
            raise ValueError("stride and checks must be positive, patience and words not negative")


def style_loss(made: Made) -> Tensor:
    """What is to be small where styles are apart: minus the change of poses by that of the style.

    Smooth L1 (beta 0.05) of the poses in two styles, summed over frames and channels, by the mean
    absolute difference of the styles; not below -1000; mean over the batch. Only the poses of the
    first style are learnt from.
    """
    apart = smooth_l1_loss(made.pose, made.other_pose, reduction="none", beta=STYLE).sum((1, 2))
    styles = (made.style - made.other_style).abs().mean(1).detach() + 1e-5
    return (-apart / styles).clamp_min(-1000).mean()


def divergence(mean: Tensor, log_variance: Tensor) -> Tensor:
    """Divergence of Gaussians (B, Z) from the standard one, mean over all."""
    return -0.5 * (1 + log_variance - mean.square() - log_variance.exp()).mean()


def generator_losses(
    made: Made, pose: Tensor, training: TriConTraining, word: Tensor | None
) -> dict[str, Tensor]:
    """Weighted losses of the generator by their names.

    Args:
        made: by the network.
        pose: (B, T, D) recorded.
        training: weights.
        word: (B,) the critic's probabilities; None where it is silent.
    """
    losses = {"huber": training.huber * smooth_l1_loss(made.pose, pose, beta=HUBER)}
    if word is not None:
        losses["adversarial"] = training.adversarial * -(word + LOG).log().mean()
    if made.style.shape[1] and training.style:
        losses["style"] = training.style * style_loss(made)
    if made.style.shape[1] and training.divergence:
        losses["divergence"] = training.divergence * divergence(made.mean, made.log_variance)
    return losses


def critic_loss(real: Tensor, made: Tensor) -> Tensor:
    """Cross-entropy of the critic's probabilities (B,) of recorded and of generated poses."""
    return -((real + LOG).log() + (1 - made + LOG).log()).mean()


class Windows:
    """Windows of clips at the model's rate, held as poses, sound in 16 bits and places of words.

    Items are dictionaries: `pose` (T, D), `sound` (N,), `words` (T,) int64, `speaker` () int64.

    Attributes:
        rows: (1 + V, M) of the words, for the encoder.
    """

    def __init__(
        self, clips: Sequence[MotionClip], model: TriCon, context: StageContext, places: list[int]
    ) -> None:
        self.config, statistics = model.config, context.statistics
        self.poses, self.sounds, self.words, self.speakers = [], [], [], []
        for clip in clips:
            rest, place = statistics.rest_of(clip.speaker), statistics.place_of(clip.speaker)
            self.poses.append(model.poses.encode(own_rate(clip, self.config), rest))
            sound = context.sound(clip.name) if self.config.hears else np.zeros(0)
            self.sounds.append(np.round(sound * 32767).astype(np.int16))
            said = clip.speech.words or ()
            mine, places = places[: len(said)], places[len(said) :]
            frames = len(self.poses[-1])
            self.words.append(words_of_frames(said, mine, frames, self.config.fps))
            self.speakers.append(place)
        self.starts: list[tuple[int, int]] = []

    def cut(self, stride: int) -> None:
        """Windows every so many frames."""
        for index, pose in enumerate(self.poses):
            firsts = range(0, len(pose) - self.config.frames + 1, stride)
            self.starts += [(index, first) for first in firsts]

    def choose(self, training: TriConTraining, spoken: Sequence[bool], active: Tensor) -> None:
        """Leave out windows with few words, near the mean pose, or that are still.

        Args:
            training: how many.
            spoken: whether a clip has words.
            active: (D,) channels whose variance tells what is still.
        """
        frames = self.config.frames
        kept = [
            (index, first)
            for index, first in self.starts
            if not spoken[index]
            or np.count_nonzero(self.words[index][first : first + frames]) >= training.least_words
        ]
        poses = [self.poses[index][first : first + frames] for index, first in kept]
        measures = (
            (training.drop_plain, [float(pose.abs().mean()) for pose in poses]),
            (training.drop_still, [float(pose[:, active].var(0).mean()) for pose in poses]),
        )
        good = np.ones(len(kept), bool)
        for part, values in measures:
            if part and values:
                good &= np.array(values) >= np.quantile(values, part)
        self.starts = [start for start, keep in zip(kept, good, strict=True) if keep]

    def __len__(self) -> int:
        """Number of windows."""
        return len(self.starts)

    def __getitem__(self, number: int) -> dict[str, Tensor]:
        index, first = self.starts[number]
        last = first + self.config.frames
        return {
            "pose": self.poses[index][first:last],
            "sound": torch.from_numpy(piece(self.sounds[index], first, self.config)),
            "words": torch.from_numpy(self.words[index][first:last]),
            "speaker": torch.tensor(self.speakers[index]),
        }


def piece(samples: NDArray, first: int, config: TriConConfig) -> NDArray[np.float32]:
    """Sound (N,) float32 of a window that begins with frame `first`; silence after the end.

    Args:
        samples: (n,) of the whole recording, floats or 16 bits.
        first: frame at the model's rate.
        config: how long a window is.
    """
    if not config.hears:
        return np.zeros(0, np.float32)
    begin = round(first * SAMPLE_RATE / config.fps)
    part = samples[begin : begin + config.samples]
    scale = np.float32(1 / 32767 if part.dtype == np.int16 else 1)
    return np.pad(part.astype(np.float32) * scale, (0, config.samples - len(part)))


def own_rate(clip: MotionClip, config: TriConConfig) -> Tensor:
    """Motion vectors (T, C) of a clip at the model's rate."""
    return resample(clip.motion, FPS, config.fps, smooth=True).vector()


def window_poses(windows: Windows) -> Tensor:
    """Poses (n, T, D) of all windows."""
    frames = windows.config.frames
    return torch.stack([windows.poses[i][first : first + frames] for i, first in windows.starts])


def begin_model(
    context: StageContext, clips: Sequence[MotionClip], spoken: Sequence[str]
) -> TriCon:
    """The untrained model; tree, mean and scale of its poses are those of the clips."""
    config, training = context.settings.model, context.settings.train
    words = None
    if config.reads and config.encoder == "vectors":
        if not training.vectors:
            raise BadInput(
                "tricon.train.vectors: name a .vec file, or leave tricon.model.encoder=hash"
            )
        words = KnownWords.begun(spoken, Path(training.vectors))
    model = TriCon(config, len(context.statistics.speakers), words)
    motions = [own_rate(clip, config) for clip in clips]
    rests = [context.statistics.rest_of(clip.speaker) for clip in clips]
    model.poses.fit(motions, rests, config.bones)
    return model


def active_channels(model: TriCon, active: Tensor) -> Tensor:
    """(D,) bool: channels of the places of the points (K,) bool that gesture."""
    poses = model.poses
    shown = active[poses.parents >= 0] if poses.kind == "directions" else active
    chosen = torch.zeros(poses.size, dtype=torch.bool)
    chosen[: len(shown) * poses.axes] = shown.repeat_interleave(poses.axes)
    return chosen


def train_generator(context: StageContext) -> Trained:
    """Train generator and critic in turn; of the generator the weights with the lowest FGD stay."""
    config, training = context.settings.model, context.settings.train
    least = int(np.ceil((config.frames - 1) * FPS / config.fps)) + 1
    clips, others = context.clips(least)
    said = [word.word for clip in [*clips, *others] for word in clip.speech.words or ()]
    torch.manual_seed(context.seed)
    model = begin_model(context, clips, [w for c in clips for w in said_in(c)])
    rows, places = word_rows(model, said)
    count = sum(len(clip.speech.words or ()) for clip in clips)
    windows = Windows(clips, model, context, places[:count])
    windows.cut(training.stride)
    spoken = [bool(clip.speech.words) for clip in clips]
    active = active_channels(model, context.statistics.active)
    windows.choose(training, spoken, active)
    if len(windows) < 2:
        raise BadInput(
            f"{context.place}: {len(windows)} training windows of {config.frames} frames are left; "
            "tricon.train.least_words=0, drop_plain=0 and drop_still=0 keep all"
        )
    held = Windows(others, model, context, places[count:])
    held.cut(training.stride)
    judge = judge_of(context, window_poses(windows)) if len(held) > 1 else None
    schedule, items = training.schedule, len(windows)
    run = context.begin(schedule.steps(items))
    critic = Critic(model.poses.size, config.frames)
    made_by = run.add("generator", model, schedule.adam(model), schedule.milestone_steps(items))
    rate = schedule.rate * training.critic_rate
    told_by = run.add("critic", critic, torch.optim.Adam(critic.parameters(), rate, schedule.betas))
    batches = run.batches(windows, min(schedule.batch, items))
    rows = rows.to(run.device)
    for step in run.steps():
        batch = next(batches)
        pose, words = batch["pose"], hidden(batch["words"], training.word_dropout)
        other = batch["speaker"][torch.randperm(len(pose), device=run.device)]
        seeds = seeded(pose[:, : config.seeds], config.frames)
        made = made_by(seeds, batch["sound"], words, rows, batch["speaker"], other)
        scalars, word = {}, None
        if training.adversarial and step >= training.quiet * run.total:
            scalars["critic"] = critic_loss(told_by(pose), told_by(made.pose.detach()))
            run.update(scalars["critic"], "critic", clip=schedule.clip)
            word = critic.forward(made.pose)
        losses = generator_losses(made, pose, training, word)
        run.update(torch.stack(list(losses.values())).sum(), "generator", clip=schedule.clip)
        if judge is not None and run.due(training.checks):
            run.keep_best(held_out_distance(model, judge, held, rows), training.patience)
        run.log(**losses, **scalars)
    run.restore_best()
    report: dict[str, Any] = {"windows": items, "weights": numbers_of(model), "steps": run.step}
    if judge is not None:
        report["fgd"] = round(run.best.score, 4)
        report["fgd_still"] = round(still_distance(judge, held), 4)
    return Trained(model.eval().cpu().state_dict(), report)


def said_in(clip: MotionClip) -> list[str]:
    """Words of a clip."""
    return [word.word for word in clip.speech.words or ()]


def word_rows(model: TriCon, said: Sequence[str]) -> tuple[Tensor, list[int]]:
    """Rows of different words for the model's encoder, and the place of each word said in them."""
    different = {word: place for place, word in enumerate(dict.fromkeys(said), 1)}
    places = [different[word] for word in said]
    if not model.config.reads:
        return torch.zeros(1, 1, dtype=torch.int64), [0] * len(places)
    return model.words.rows(list(different)), places


def hidden(words: Tensor, share: float) -> Tensor:
    """Words (B, T) of windows, of some at random taken away."""
    if not share:
        return words
    kept = torch.rand(len(words), 1, device=words.device) >= share
    return words * kept


def numbers_of(model: TriCon) -> int:
    """Trained numbers of a model."""
    return sum(parameter.numel() for parameter in model.parameters())


def judge_of(context: StageContext, poses: Tensor) -> MotionAutoencoder:
    """The network of FGD in the model's own poses, trained on its windows; cached."""
    judge = MotionAutoencoder(poses.shape[2], poses.shape[1])
    training = AutoencoderTraining(most_steps=context.settings.train.judge_steps)

    def make() -> Mapping[str, Tensor]:
        data = judged(poses)
        steps = training.steps(len(data))
        run = Run(context.folder, "judge", steps=steps, seed=context.seed, config=context.run)
        return train_autoencoder(data, run, training).cpu().state_dict()

    judge.load_state_dict(context.cached("judge-weights", make))
    return judge.eval().requires_grad_(False)


def judged(poses: Tensor) -> NDArray[np.float32]:
    """Poses (n, T, D) as the judge sees them: of deviation 1."""
    return (5 * poses).cpu().numpy()


@torch.no_grad()
def held_out_distance(
    model: TriCon, judge: MotionAutoencoder, windows: Windows, rows: Tensor, at_once: int = 128
) -> float:
    """FGD of what the model makes of held-out windows, each begun with its own first poses."""
    device, config = model.poses.mean.device, model.config
    model.eval()
    made = []
    generator = torch.Generator().manual_seed(0)  # the same styles in every evaluation
    for first in range(0, len(windows), at_once):
        items = [windows[i] for i in range(first, min(first + at_once, len(windows)))]
        batch = {key: torch.stack([item[key] for item in items]).to(device) for key in items[0]}
        style = batch["pose"].new_zeros(len(items), 0)
        if config.identity:
            mean, log_variance = model.styles(batch["speaker"])
            noise = torch.randn(mean.shape, generator=generator).to(device)
            style = mean + (0.5 * log_variance).exp() * noise
        seeds = seeded(batch["pose"][:, : config.seeds], config.frames)
        context = model.context(batch["sound"], batch["words"], rows)
        made.append(model.gesture(seeds, context, style).cpu())
    model.train()
    return distance_of(judge, torch.cat(made), windows)


def distance_of(judge: MotionAutoencoder, made: Tensor, windows: Windows) -> float:
    """FGD of poses (n, T, D) from those of windows."""
    features = partial(encode_windows, judge)
    score = feature_distance(features(judged(window_poses(windows))), features(judged(made)))
    return float("inf") if score.value is None else score.value


def still_distance(judge: MotionAutoencoder, windows: Windows) -> float:
    """FGD of windows in which the first pose is held."""
    poses = window_poses(windows)
    return distance_of(judge, poses[:, :1].expand_as(poses), windows)
