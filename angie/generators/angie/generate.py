"""ANGIE as a generator: codes from the GPT, motion from the decoders, refined by rhythm."""

from dataclasses import dataclass, field, replace
from typing import Any

import torch
from torch import Tensor

from angie.generators.angie.channels import Channels
from angie.generators.angie.codes import encode_whole
from angie.generators.angie.gpt import CoSpeechGPT
from angie.generators.angie.refiner import Refiner
from angie.generators.angie.sampling import Sampling, Window, continue_codes
from angie.generators.angie.tokenizer import DirectMotion, VQMotionExtractor
from angie.generators.base import GestureGenerator
from angie.motion.drift import MODES, Anchors, activity, bounded, integrate_bounded, remove_mean
from angie.motion.statistics import MotionStatistics
from angie.motion.windows import BLENDS, WINDOW
from data_prep.errors import BadInput
from data_prep.rates import FPS, FRAMES_PER_TOKEN, tokens_covering
from data_prep.speech.features import Speech
from mraa.motion import Motion, positive, render_floor

DECODINGS = ("full", "chunked", "auto")

VOICE_FEATURES = {"recording": "onset", "causal": "voice_causal"}
"""Feature from which `Sampling.voice` tells where there is sound."""

HEARD_AHEAD = 0.3
"""Seconds after the beginning of a token that its features of sound as it comes know."""


@dataclass(frozen=True)
class GenerationConfig:
    """How motion is generated; the defaults are the paper's.

    Attributes:
        sampling: how codes are chosen.
        window: what the GPT sees of long sound.
        bounding: drift bounding, "auto" (above 10 s), "on" or "off".
        decode: "full" (all codes in one pass), "chunked" (12 codes at a time, blended) or
            "auto": whichever reconstructed long held-out clips better after training.
        blend: how windows of decoder and refiner are blended, "linear", "hann" or "ahead", which
            looks at most a token ahead and always decodes in windows; see
            `angie.motion.windows.BLENDS`.
        refine: add the refiner's residuals.
        reanchor: where motion is bounded, fade toward a training pose in pauses.
        render_floor: keep diagonals of L where the renderer has seen them; without it they are
            above 1e-5 (ReLU + eps), as in the paper.
    """

    sampling: Sampling = field(default_factory=Sampling)
    window: Window = field(default_factory=Window)
    bounding: str = "off"
    decode: str = "full"
    blend: str = "linear"
    refine: bool = True
    reanchor: bool = False
    render_floor: bool = True

    def __post_init__(self) -> None:
        if self.bounding not in MODES:
            raise ValueError(f"bounding is one of {', '.join(MODES)}, not {self.bounding!r}")
        if self.decode not in DECODINGS:
            raise ValueError(f"decode is one of {', '.join(DECODINGS)}, not {self.decode!r}")
        if self.blend not in BLENDS:
            raise ValueError(f"blend is one of {', '.join(BLENDS)}, not {self.blend!r}")


@dataclass(frozen=True)
class Controls:
    """What can be asked of ANGIE beside the sound.

    Attributes:
        temperature: of the sampling, above 0; None as the settings say.
    """

    temperature: float | None = None


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
class AngieGenerator(GestureGenerator):
    """ANGIE (NeurIPS 2022): codes from the GPT, deltas from the decoders, refined by rhythm.

    Attributes:
        vq: VQ motion extractor, or the model that regresses motion without codes.
        gpt: co-speech GPT trained on its codes; None for a model without codes.
        refiner: refiner trained on its patterns.
        statistics: those all three were trained with.
        config: how to generate.
    """

    vq: VQMotionExtractor | DirectMotion
    gpt: CoSpeechGPT | None
    refiner: Refiner
    statistics: MotionStatistics
    config: GenerationConfig = field(default_factory=GenerationConfig)
    chunked: bool = False
    """What `decode="auto"` means for these parts."""

    fps = FPS
    features = ("onset", "mfcc")
    lookahead = None
    """Seconds where features, voice and windows are those of sound as it comes; else all of it."""

    @property
    def random(self) -> bool:
        """Whether the settings say that codes are drawn."""
        return self.gpt is not None and self.config.sampling.method != "greedy"

    def __post_init__(self) -> None:
        regions = {self.vq.config.regions, self.refiner.config.regions, self.statistics.regions}
        direct = isinstance(self.vq, DirectMotion)
        if self.gpt is None or direct:
            fit = direct and self.gpt is None
        else:
            sizes, codes = self.gpt.config, self.vq.config
            fit = (sizes.codes, sizes.streams) == (codes.codes, codes.streams)
        if len(regions) > 1 or not fit:
            raise ValueError("the parts of the generator were not trained on one another")
        for part in (self.vq, self.gpt, self.refiner):
            if part is not None:
                part.eval().requires_grad_(False)
        self.channels = Channels.of(self.statistics, self.vq.config.quant)
        listener = self.vq.transformer if isinstance(self.vq, DirectMotion) else self.gpt
        assert listener is not None
        self.sound: str = listener.config.sound
        voice = () if self.gpt is None else (VOICE_FEATURES[self.config.sampling.voice],)
        self.features = tuple(dict.fromkeys((self.sound, "mfcc", *voice)))
        self.lookahead = self._lookahead()

    def _lookahead(self) -> float | None:
        """Seconds of sound after a frame that its pose depends on; None if it is all of it."""
        heard = {self.sound, *self.features} <= {"onset_causal", "voice_causal", "mfcc"}
        if not heard or self.config.blend != "ahead" or self.config.bounding == "auto":
            return None
        return (2 if self.config.refine else 1) * FRAMES_PER_TOKEN / FPS + HEARD_AHEAD

    @torch.no_grad()
    def generate(
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
        start_codes: Tensor | None = None,
    ) -> Motion:
        """Gesture to speech; see `GestureGenerator.generate` for the arguments.

        The first pair of codes of `seed_motion` begins the motion (the protocol of the papers'
        tables), or else `start_codes` (streams, P); without either it begins still. Joint models
        alone tell styles apart; there are no `controls`.

        Raises:
            ValueError: speech of fewer than `frames` frames, or a start pose of other regions.
            BadInput: an unknown speaker or style.
        """
        if not isinstance(controls, Controls | None):
            raise BadInput(f"controls {controls!r}: give ANGIE's Controls, or leave them out")
        if isinstance(style, Tensor):
            raise BadInput("--style: this generator knows styles by the names of speakers only")
        if start_codes is None and seed_motion is not None:
            codes = self.codes_of(seed_motion[:WINDOW])
            start_codes = None if codes is None else codes[:, :1]
        tokens = tokens_covering(frames)
        if not 1 <= frames <= speech.frames:
            raise ValueError(f"{frames} frames need as many of speech, not {speech.frames}")
        if start.frames != 1 or start.regions != self.statistics.regions:
            raise ValueError(f"the start pose is one frame of {self.statistics.regions} regions")
        first = start.vector()[0].detach().cpu().float()
        onset = torch.as_tensor(speech[self.sound][:tokens])
        mfcc = torch.as_tensor(speech["mfcc"][:frames])
        like = speaker if style is None else style
        who = None if like is None else self.statistics.place_of(like)
        if isinstance(self.vq, DirectMotion):
            sound = self.statistics.standard_sound(self.sound, onset)
            delta = self.vq.predict(sound, who, self.config.blend)
        else:
            sampling, voice = self.config.sampling, VOICE_FEATURES[self.config.sampling.voice]
            if greedy is not None:
                sampling = replace(sampling, method="greedy" if greedy else "topk")
            if controls is not None and controls.temperature is not None:
                sampling = replace(sampling, temperature=controls.temperature)
            heard = torch.as_tensor(speech[voice][:tokens])
            voiced = heard > 0 if voice == "voice_causal" else voiced_tokens(heard)
            codes = self.draw_codes(onset, seed, start_codes, who, sampling, voiced)
            delta = self.decode(codes)
        pattern = self.integrate(delta[:frames], first, speaker)
        motion = pattern + self.residual(mfcc, pattern) if self.config.refine else pattern
        return self.renderable(motion, first)

    @torch.no_grad()
    def codes_of(self, motion: Motion) -> Tensor | None:
        """Codes (streams, S) of recorded motion, to begin generated motion with (`start_codes`).

        All codes of a clip are its reconstruction; its first one alone, `codes[:, :1]`, is the
        protocol of the papers' tables; those of a few seconds of another clip are a seed.
        Motion that ends inside a token is continued with stillness.

        Args:
            motion: recorded motion of any length.

        Returns:
            the codes, or None if the generator has none.
        """
        if isinstance(self.vq, DirectMotion):
            return None
        return encode_whole(self.vq, motion.vector(), self.channels)

    def reconstruct(self, speech: Speech, motion: Motion, speaker: str | None = None) -> Motion:
        """Recorded motion through its own codes: encoded, decoded, refined.

        Nothing is drawn and nothing bounded; it is what the image scores of the paper's Table 3
        are of. Without codes it is what the sound gives.
        """
        whole = replace(self, config=replace(self.config, bounding="off"))
        codes = self.codes_of(motion)
        return whole.generate(
            speech, motion[:1], motion.frames, speaker=speaker, greedy=None, start_codes=codes
        )

    def draw_codes(
        self,
        onset: Tensor,
        seed: int,
        start_codes: Tensor | None,
        speaker: int | None = None,
        sampling: Sampling | None = None,
        voiced: Tensor | None = None,
    ) -> Tensor:
        """Codes (streams, S) of raw features of the tokens (S, 426) and where there is a voice."""
        assert isinstance(self.vq, VQMotionExtractor) and self.gpt is not None
        still = self.vq.start_codes().cpu()
        begin = still[:, None] if start_codes is None else start_codes
        return continue_codes(
            self.gpt,
            begin,
            self.statistics.standard_sound(self.sound, onset),
            sampling or self.config.sampling,
            torch.Generator().manual_seed(seed),
            voiced=voiced_tokens(onset) if voiced is None else voiced,
            window=self.config.window,
            speaker=speaker,
            still=still,
        )

    def decode(self, codes: Tensor) -> Tensor:
        """Normalised deltas (8S, 5K) of codes (streams, S) on the CPU."""
        assert isinstance(self.vq, VQMotionExtractor)
        codes = codes.to(self.vq.mean.device)
        chunked = self.chunked if self.config.decode == "auto" else self.config.decode == "chunked"
        chunked = chunked or self.config.blend == "ahead"
        return (
            self.vq.decode_chunked(codes, self.config.blend)
            if chunked
            else self.vq.decode_whole(codes)
        )

    def integrate(self, delta: Tensor, start: Tensor, speaker: str | None) -> Tensor:
        """Pattern motion (T, 5K) of normalised deltas.

        Bounding is for relative shift and Cholesky factor; other variants are summed up plainly.
        """
        statistics = self.statistics
        plain = self.channels.covariance or not self.channels.all_relative
        if plain or not bounded(self.config.bounding, len(delta)):
            return self.channels.integrate(delta, start)
        rest = start if speaker is None else statistics.rest_of(speaker)
        delta = remove_mean(delta, self.vq.mean.cpu())
        anchors = None
        if self.config.reanchor and len(statistics.anchors):
            calm = activity(delta)[:, 0] <= statistics.calm
            anchors = Anchors(statistics.anchors, statistics.pose_scale, calm)
        delta = delta * statistics.delta_scale
        return integrate_bounded(delta, start, rest, statistics.low, statistics.high, anchors)

    def residual(self, mfcc: Tensor, pattern: Tensor) -> Tensor:
        """Residual motion (T, 5K); it grows from zero over the first token."""
        scale = self.statistics.pose_scale
        residual = self.refiner.refine(
            mfcc, pattern / scale, self.statistics.standard_mfcc, self.config.blend
        )
        place = torch.arange(len(residual), dtype=torch.float32)
        return residual * scale * (place / FRAMES_PER_TOKEN).clamp_max(1)[:, None]

    def renderable(self, motion: Tensor, start: Tensor) -> Motion:
        """Positive factors, within the render floor if it is on; frame 1 is the start pose."""
        pose, statistics = self._motion(start[None]), self.statistics
        fixed = positive(self._motion(motion))
        if self.config.render_floor:
            fixed = render_floor(fixed, statistics.diagonal_low, statistics.diagonal_high, pose)
        vector = fixed.vector()
        vector[0] = start
        return self._motion(vector)

    def _motion(self, vector: Tensor) -> Motion:
        """Motion of vectors (T, 5K), or (T, 2K) for points without extent."""
        if self.statistics.has_extent:
            return Motion.from_vector(vector)
        return Motion.of_points(vector.unflatten(-1, (self.statistics.regions, 2)))
