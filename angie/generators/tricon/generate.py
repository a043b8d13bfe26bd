"""TriCon as a generator: long speech in windows that begin with the last poses before them."""

import math
from typing import Any

import numpy as np
import torch
from torch import Tensor

from angie.generators.base import ResamplingGenerator, begin_at, read_style
from angie.generators.stages import Parts
from angie.generators.tricon.model import TriCon, TriConConfig, seeded
from angie.generators.tricon.train import piece, word_rows
from angie.generators.tricon.words import KnownWords, words_of_frames
from angie.motion.statistics import MotionStatistics
from data_prep.errors import BadInput
from data_prep.speech.features import Speech
from mraa.motion import Motion, positive, render_floor

PART = "tricon.generator"


def load_model(parts: Parts) -> TriCon:
    """The trained network of a bundle, on the CPU."""
    config: TriConConfig = parts.settings("tricon").model
    words = None
    if config.reads and config.encoder == "vectors":
        tensors = parts.tensors(PART)
        known, width = tensors["words.weight"].shape
        words = KnownWords(known, width, len(tensors["words.letters"]))
    model: TriCon = parts.load(PART, TriCon(config, len(parts.statistics().speakers), words))
    return model


def fade_in(before: Tensor, after: Tensor) -> Tensor:
    """Frames (n, D) that two windows share: before (n - j) / (n + 1) + after (j + 1) / (n + 1)."""
    count = len(before)
    share = (torch.arange(count, dtype=before.dtype)[:, None] + 1) / (count + 1)
    return before * (1 - share) + after * share


class TriConGenerator(ResamplingGenerator):
    """TriCon (TOG 2020): words, sound and identity to poses, window by window.

    Args:
        model: trained.
        statistics: of the motion that it was trained on.
    """

    features = ("waveform", "words")
    lookahead = None
    """A window is known when its sound is; its network reads it in both directions."""
    smooth = True

    def __init__(self, model: TriCon, statistics: MotionStatistics) -> None:
        self.model = model.eval().requires_grad_(False)
        self.statistics = statistics
        self.fps = model.config.fps

    @property
    def random(self) -> bool:
        """Whether a style is drawn."""
        return self.model.config.identity

    @torch.no_grad()
    def generate_own(
        self,
        speech: Speech,
        start: Motion,
        frames: int,
        *,
        seed: int = 0,
        speaker: str | None = None,
        style: str | Tensor | None = None,
        seed_motion: Motion | None = None,
        controls: Any = None,
        greedy: bool | None = False,
    ) -> Motion:
        """Gesture at the model's rate; see `GestureGenerator.generate`.

        Args:
            speech: its samples are needed.
            start: pose of the photo, one frame.
            frames: T.
            seed: of the style that is drawn.
            speaker: around whose rest pose motion is; None takes the start pose for rest.
            style: whose way of gesturing, see `style_of`.
            seed_motion: its first 4 frames begin the motion, as in the paper; None begins with
                the start pose, held.
            controls: there are none.
            greedy: the middle of a speaker's Gaussian; else one of its styles is drawn.

        Raises:
            ValueError: a start pose of other regions.
            BadInput: an unknown speaker or style.
        """
        if controls is not None:
            raise ValueError("this generator has no controls")
        if start.frames != 1 or start.regions != self.statistics.regions:
            raise ValueError(f"the start pose is one frame of {self.statistics.regions} regions")
        model, config = self.model, self.model.config
        first = start.vector()[0].detach().cpu().float()
        rest = first if speaker is None else self.statistics.rest_of(speaker)
        given = first[None] if seed_motion is None else seed_motion.vector()[: config.seeds]
        seeds = model.poses.encode(given, rest)
        seeds = torch.cat([seeds, seeds[-1:].expand(config.seeds - len(seeds), -1)])
        poses = self.poses(speech, seeds, frames, self.style_of(style or speaker, seed, greedy))
        motion = positive(start.like(model.poses.decode(poses, rest, first)))
        low, high = self.statistics.diagonal_low, self.statistics.diagonal_high
        motion = begin_at(render_floor(motion, low, high), start, self.fps)
        return render_floor(motion, low, high, start)

    def poses(self, speech: Speech, seeds: Tensor, frames: int, style: Tensor) -> Tensor:
        """Poses (T, D) of a recording.

        Windows of 34 frames follow one another every 30; the last 4 poses of one are the first of
        the next, and fade into what that makes of them. The last window hears silence at its end.

        Args:
            speech: the recording.
            seeds: (4, D) poses to begin with.
            frames: T.
            style: (Z,) of the whole recording.
        """
        config = self.model.config
        words = [word for word in speech.words or () if config.reads]
        rows, places = word_rows(self.model, [word.word for word in words])
        hop = config.frames - config.seeds
        count = max(1, math.ceil((frames - config.frames) / hop) + 1)
        said = words_of_frames(words, places, count * hop + config.seeds, config.fps)
        samples = speech.samples if config.hears else np.zeros(0, np.float32)
        made = [seeds.new_zeros(0, seeds.shape[1])]
        for first in range(0, count * hop, hop):
            context = self.model.context(
                torch.from_numpy(piece(samples, first, config))[None],
                torch.from_numpy(said[first : first + config.frames])[None],
                rows,
            )
            window = self.model.gesture(seeded(seeds[None], config.frames), context, style[None])[0]
            if first:
                made[-1], before = made[-1].split([hop, config.seeds])
                window = torch.cat(
                    [fade_in(before, window[: config.seeds]), window[config.seeds :]]
                )
            made.append(window)
            seeds = window[-config.seeds :]
        return torch.cat(made)[:frames]

    def style_of(self, style: str | Tensor | None, seed: int, greedy: bool | None) -> Tensor:
        """A point (Z,) of the style space, the same for a whole recording.

        Args:
            style: a speaker's name, a mixture "A:0.3,B:0.7", a point of the space as a tensor or
                as numbers "0.1,-0.2,..."; None is any speaker.
            seed: of who is drawn, and of the point of their Gaussian.
            greedy: no point but the middle; of all speakers, where none is named.

        Raises:
            BadInput: an unknown speaker, or not a point of the space.
        """
        size = self.model.config.style
        if not self.model.config.identity:
            if style is not None and style not in self.statistics.speakers:
                raise BadInput("--style: this model has one style only")
            return torch.zeros(0)
        rng = torch.Generator().manual_seed(seed)
        names = self.statistics.speakers
        meant: dict[str, float] | Tensor
        if style is None:
            drawn = int(torch.randint(len(names), (), generator=rng))
            meant = dict.fromkeys(names, 1.0) if greedy else {names[drawn]: 1.0}
        else:
            meant = read_style(style, names, size) if isinstance(style, str) else style
        if isinstance(meant, Tensor):
            if meant.shape != (size,):
                raise BadInput(f"--style: a point of the style space has {size} numbers")
            return meant.float()
        total = sum(meant.values())
        weights = torch.tensor([meant.get(name, 0.0) / total for name in names])
        means, log_variances = self.model.styles(torch.arange(len(names)))
        noise = torch.zeros(size) if greedy else torch.randn(size, generator=rng)
        return weights @ (means + (0.5 * log_variances).exp() * noise)
