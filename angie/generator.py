"""Gesture generators: speech and a start pose in, region motion out."""

from dataclasses import dataclass, field
from typing import Protocol

import torch
from torch import Tensor

from angie.continuation import Window, continue_codes
from angie.drift import MODES, bounded, integrate_bounded, remove_mean
from angie.gpt import CoSpeechGPT
from angie.motion import Motion, integrate, positive, render_floor
from angie.refiner import Refiner
from angie.sampling import Sampling
from angie.statistics import MotionStatistics
from angie.vq import VQMotionExtractor
from data_prep.features import SpeechFeatures
from data_prep.rates import FRAMES_PER_TOKEN, tokens_covering

DECODINGS = ("full", "chunked")


class GestureGenerator(Protocol):
    """What every gesture generator can do."""

    def generate(
        self,
        speech: SpeechFeatures,
        start: Motion,
        frames: int,
        seed: int = 0,
        speaker: str | None = None,
    ) -> Motion:
        """Gesture to speech.

        Args:
            speech: features of the whole recording, covering at least `frames` frames.
            start: pose of the photo, one frame: shift (1, K, 2), cholesky (1, K, 3).
            frames: number of frames T to make, 25 a second.
            seed: everything random follows from it.
            speaker: name of a speaker of the training set, or None for anyone.

        Returns:
            Motion of exactly T frames on the CPU; frame 1 is the start pose.
        """
        ...


@dataclass(frozen=True)
class GenerationConfig:
    """How motion is generated; the defaults are the paper's.

    Attributes:
        sampling: how codes are chosen.
        window: what the GPT sees of long sound.
        bounding: drift bounding, "auto" (above 10 s), "on" or "off".
        decode: "full" (all codes in one pass) or "chunked" (12 codes every 6, cross-faded).
        refine: add the refiner's residuals.
    """

    sampling: Sampling = field(default_factory=Sampling)
    window: Window = field(default_factory=Window)
    bounding: str = "off"
    decode: str = "full"
    refine: bool = True

    def __post_init__(self) -> None:
        if self.bounding not in MODES:
            raise ValueError(f"bounding is one of {', '.join(MODES)}, not {self.bounding!r}")
        if self.decode not in DECODINGS:
            raise ValueError(f"decode is one of {', '.join(DECODINGS)}, not {self.decode!r}")


def voiced_tokens(onset: Tensor) -> Tensor:
    """Which tokens have sound, from the level in the first cepstral coefficient.

    A token is voiced when its level is above floor + 0.15 (p95 - floor), the floor being the 5th
    percentile; sound of constant level, such as digital silence, has no voiced token.

    Args:
        onset: (S, 426) raw onset features.

    Returns:
        (S,) bool.
    """
    level = onset[:, 0].double()
    floor, loud = level.quantile(torch.tensor([0.05, 0.95], dtype=torch.float64)).unbind()
    return level > floor + 0.15 * (loud - floor)


@dataclass
class AngieGenerator:
    """ANGIE (NeurIPS 2022): codes from the GPT, deltas from the decoders, refined by rhythm.

    Attributes:
        vq: VQ motion extractor.
        gpt: co-speech GPT trained on its codes.
        refiner: refiner trained on its patterns.
        statistics: those all three were trained with.
        config: how to generate.
    """

    vq: VQMotionExtractor
    gpt: CoSpeechGPT
    refiner: Refiner
    statistics: MotionStatistics
    config: GenerationConfig = field(default_factory=GenerationConfig)

    def __post_init__(self) -> None:
        regions = {
            self.vq.config.regions,
            self.refiner.config.regions,
            self.statistics.regions,
        }
        if len(regions) > 1 or self.vq.config.codes != self.gpt.config.codes:
            raise ValueError("the parts of the generator were not trained on one another")
        for part in (self.vq, self.gpt, self.refiner):
            part.eval().requires_grad_(False)

    @torch.no_grad()
    def generate(
        self,
        speech: SpeechFeatures,
        start: Motion,
        frames: int,
        seed: int = 0,
        speaker: str | None = None,
        start_codes: Tensor | None = None,
    ) -> Motion:
        """Gesture to speech; see `GestureGenerator.generate`.

        Args:
            speech: features of the whole recording.
            start: pose of the photo, one frame.
            frames: number of frames T to make.
            seed: of the sampling; the same seed gives the same motion on one device.
            speaker: a speaker of the training set, whose rest pose long motion returns to; None
                takes the start pose for rest.
            start_codes: (2, P) codes to begin with, such as those of a seed motion; None begins
                still.

        Raises:
            ValueError: too few features for `frames`, or a start pose of other regions.
            BadInput: an unknown speaker.
        """
        tokens = tokens_covering(frames)
        if frames < 1 or len(speech.mfcc) < frames or len(speech.onset) < tokens:
            raise ValueError(
                f"{frames} frames need as many MFCC windows and {tokens} onset features, "
                f"not {len(speech.mfcc)} and {len(speech.onset)}"
            )
        if start.frames != 1 or start.regions != self.statistics.regions:
            raise ValueError(f"the start pose is one frame of {self.statistics.regions} regions")
        first = start.vector()[0].detach().cpu().float()
        onset = torch.as_tensor(speech.onset[:tokens])
        mfcc = torch.as_tensor(speech.mfcc[:frames])
        codes = self._codes(onset, seed, start_codes)
        delta = self._decode(codes)[:frames]
        pattern = self._integrate(delta, first, speaker)
        motion = pattern + self._residual(mfcc, pattern) if self.config.refine else pattern
        return self._renderable(motion, first)

    def _codes(self, onset: Tensor, seed: int, start_codes: Tensor | None) -> Tensor:
        """Codes (2, S) of raw onset features (S, 426)."""
        generator = torch.Generator().manual_seed(seed)
        begin = self.vq.start_codes()[:, None] if start_codes is None else start_codes
        standard = self.statistics.standard_onset(onset)
        voiced = voiced_tokens(onset)
        return continue_codes(
            self.gpt,
            begin,
            standard,
            self.config.sampling,
            generator,
            voiced=voiced,
            window=self.config.window,
        )

    def _decode(self, codes: Tensor) -> Tensor:
        """Normalised deltas (8S, 5K) of codes (2, S) on the CPU."""
        codes = codes.to(self.vq.mean.device)
        chunked = self.config.decode == "chunked"
        return self.vq.decode_chunked(codes) if chunked else self.vq.decode_whole(codes)

    def _integrate(self, delta: Tensor, start: Tensor, speaker: str | None) -> Tensor:
        """Pattern motion (T, 5K) of normalised deltas."""
        statistics = self.statistics
        rest = start if speaker is None else statistics.rest_of(speaker)
        if not bounded(self.config.bounding, len(delta)):
            return integrate(delta * statistics.delta_scale, start)
        delta = remove_mean(delta, self.vq.mean.cpu()) * statistics.delta_scale
        return integrate_bounded(delta, start, rest, statistics.low, statistics.high)

    def _residual(self, mfcc: Tensor, pattern: Tensor) -> Tensor:
        """Residual motion (T, 5K); it grows from zero over the first token."""
        scale = self.statistics.pose_scale
        residual = self.refiner.refine(mfcc, pattern / scale, self.statistics.standard_mfcc)
        place = torch.arange(len(residual), dtype=torch.float32)
        return residual * scale * (place / FRAMES_PER_TOKEN).clamp_max(1)[:, None]

    def _renderable(self, motion: Tensor, start: Tensor) -> Motion:
        """Positive factors within the render floor; frame 1 is the start pose."""
        pose = Motion.from_vector(start[None])
        statistics = self.statistics
        fixed = positive(Motion.from_vector(motion))
        fixed = render_floor(fixed, statistics.diagonal_low, statistics.diagonal_high, pose)
        vector = fixed.vector()
        vector[0] = start
        return Motion.from_vector(vector)
