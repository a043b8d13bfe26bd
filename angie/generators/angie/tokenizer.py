"""The VQ motion extractor: relative motion to codes of common patterns and back.

Two independent streams, one for the deltas of shift (2K channels) and one for the deltas of the
Cholesky factor (3K channels): ANGIE (NeurIPS 2022), sections 3.2 and 3.3; the layers are those of
Bailando's motion VQ-VAE. Deltas are in units of their training standard deviation.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn

from angie.generators.angie.channels import QUANTS
from angie.generators.angie.gpt import CoSpeechGPT, GPTConfig
from angie.layers.vqvae import RESTART_BELOW, Codebook, Decoder, Encoder, Quantized
from angie.motion.windows import WINDOW_TOKENS, cross_fade
from data_prep.rates import FRAMES_PER_TOKEN

BLOCK = 128
"""Codes of a long sequence that are decoded at once."""


HALO = 27
"""Codes on either side that a decoded frame may depend on."""


CONTEXTS = ("window", "clip")
"""What a code is read from: a window by itself, or all of its clip."""


@dataclass(frozen=True)
class VQConfig:
    """Architecture of the VQ motion extractor; the defaults are the paper's.

    Attributes:
        regions: K.
        width: channels of the convolutions.
        codes: entries V of each codebook.
        code_width: numbers of an entry.
        update: codebook update, "loss" (equation 9) or "ema"; see `angie.layers.vqvae.Codebook`.
        decay: of the codebook's moving averages under "ema".
        restart_below: moving count below which an entry restarts under "ema"; 0 for never.
        quant: what is quantised, "full" or a variant of the paper's Table 3; see
            `angie.generators.angie.channels`.
        streams: 2 are shift and Cholesky factor, 1 is shift alone (keypoints); the naive scheme
            has 3: shift, covariance and its root.
        context: what GPT and refiner learn: codes of windows by themselves, as in the paper, or
            "clip", of whole clips in one pass. A code depends on all of its window and on the
            zeros that pad it: those at its ends are of another kind than those in the middle,
            and the GPT, which learns both, would put them in the middle of long sound.
    """

    regions: int = 20
    width: int = 512
    codes: int = 512
    code_width: int = 512
    update: str = "loss"
    decay: float = 0.99
    restart_below: float = RESTART_BELOW
    quant: str = "full"
    streams: int = 2
    context: str = "window"

    def __post_init__(self) -> None:
        if self.quant not in QUANTS:
            raise ValueError(f"quant is one of {', '.join(QUANTS)}, not {self.quant!r}")
        if self.context not in CONTEXTS:
            raise ValueError(f"context is one of {', '.join(CONTEXTS)}, not {self.context!r}")
        if self.streams not in (1, 2, 3) or (self.streams == 3) != (self.quant == "naive"):
            raise ValueError(
                f"there are 1 or 2 streams of codes, 3 with quant=naive, not {self.streams}"
            )
        if min(self.regions, self.width, self.codes, self.code_width) < 1:
            raise ValueError("regions, width, codes and code_width must be positive")
        if self.restart_below < 0:
            raise ValueError("restart_below is a count of vectors, 0 for no restarts")

    @property
    def channels(self) -> list[int]:
        """Channels of each stream."""
        return [2 * self.regions, 3 * self.regions, 4 * self.regions][: self.streams]


@dataclass
class Reconstruction:
    """Relative motion after the codebooks.

    Attributes:
        deltas: (B, T, 5K) reconstructed deltas, normalised; T is a multiple of 8.
        codes: (B, streams, S) int64, shift stream first.
        commitment: () commitment losses of the two streams, added.
        latent: () codebook losses of the two streams, added; zero under EMA.
    """

    deltas: Tensor
    codes: Tensor
    commitment: Tensor
    latent: Tensor


class VQStream(nn.Module):
    """Encoder, codebook and decoder of one stream."""

    def __init__(self, channels: int, config: VQConfig) -> None:
        super().__init__()
        self.encoder = Encoder(channels, config.width, config.code_width)
        self.codebook = Codebook(
            config.codes, config.code_width, config.update, config.decay, config.restart_below
        )
        self.decoder = Decoder(channels, config.width, config.code_width)

    def forward(self, deltas: Tensor) -> tuple[Tensor, Quantized]:
        """Deltas (B, T, C) to their reconstruction (B, 8S, C) and what the codebook said."""
        quantized = self.codebook(self.encoder(deltas))
        return self.decoder(quantized.values), quantized

    def unquantized(self, deltas: Tensor) -> Tensor:
        """Deltas (B, T, C) to their reconstruction (B, 8S, C) without the codebook."""
        return self.decoder(self.encoder(deltas))

    @torch.no_grad()
    def encode(self, deltas: Tensor) -> Tensor:
        """Codes (B, S) of deltas (B, T, C)."""
        return self.codebook.nearest(self.encoder(deltas))

    @torch.no_grad()
    def decode(self, codes: Tensor) -> Tensor:
        """Deltas (B, 8S, C) of codes (B, S)."""
        return self.decoder(self.codebook.dequantize(codes))


class VQMotionExtractor(nn.Module):
    """Relative motion to and from two streams of codes.

    Args:
        config: architecture.
    """

    mean: Tensor

    def __init__(self, config: VQConfig) -> None:
        super().__init__()
        self.config = config
        self.shift = VQStream(2 * config.regions, config)
        if config.streams > 1:
            self.cholesky = VQStream(3 * config.regions, config)
        if config.streams > 2:
            self.affine = VQStream(4 * config.regions, config)
        self.register_buffer("mean", torch.zeros(sum(config.channels)))
        """(5K,) long-run mean of decoded deltas for each unit of activity; drift bounding."""

    @property
    def streams(self) -> list[VQStream]:
        """Shift and, as far as there are such, the streams of the extent."""
        names = ("shift", "cholesky", "affine")[: self.config.streams]
        return [getattr(self, name) for name in names]

    def forward(self, deltas: Tensor, quantise: bool = True) -> Reconstruction:
        """Encode, quantise and decode normalised deltas (B, T, 5K).

        Without `quantise` latent vectors go to the decoder as they are, and all else is zero.
        """
        parts = deltas.split(self.config.channels, dim=-1)
        if not quantise:
            made = [s.unquantized(part) for s, part in zip(self.streams, parts, strict=True)]
            tokens = deltas.shape[1] // FRAMES_PER_TOKEN
            codes = torch.zeros(len(deltas), len(made), tokens, dtype=torch.int64)
            none = deltas.new_zeros(())
            return Reconstruction(torch.cat(made, dim=-1), codes.to(deltas.device), none, none)
        results = [stream(part) for stream, part in zip(self.streams, parts, strict=True)]
        quantized = [codes for _, codes in results]
        return Reconstruction(
            deltas=torch.cat([made for made, _ in results], dim=-1),
            codes=torch.stack([one.codes for one in quantized], dim=1),
            commitment=torch.stack([one.commitment for one in quantized]).sum(),
            latent=torch.stack([one.latent for one in quantized]).sum(),
        )

    @torch.no_grad()
    def init_codebook(self, deltas: Tensor) -> None:
        """Take the cluster centres of the latent vectors of deltas (n, T, 5K) as codebooks."""
        parts = deltas.split(self.config.channels, dim=-1)
        for stream, part in zip(self.streams, parts, strict=True):
            latent = [stream.encoder(some) for some in part.split(64)]
            stream.codebook.init_entries(torch.cat(latent).flatten(0, 1))

    def encode(self, deltas: Tensor) -> Tensor:
        """Codes (B, streams, T // 8) int64 of normalised deltas (B, T, 5K)."""
        parts = deltas.split(self.config.channels, dim=-1)
        codes = [stream.encode(part) for stream, part in zip(self.streams, parts, strict=True)]
        return torch.stack(codes, dim=1)

    def decode(self, codes: Tensor) -> Tensor:
        """Normalised deltas (B, 8S, 5K) of codes (B, streams, S)."""
        parts = zip(self.streams, codes.unbind(1), strict=True)
        return torch.cat([stream.decode(part) for stream, part in parts], dim=-1)

    def decode_whole(self, codes: Tensor) -> Tensor:
        """Deltas (8S, 5K) on the CPU of one sequence of codes (streams, S), as in one pass.

        A frame depends on fewer than 27 codes on either side, so blocks of 128 with those around
        them give the same, and memory beside the result does not grow with S.
        """
        parts = []
        for first in range(0, codes.shape[-1], BLOCK):
            before = min(first, HALO)
            block = codes[None, :, first - before : first + BLOCK + HALO]
            deltas = self.decode(block)[0, before * FRAMES_PER_TOKEN :]
            parts.append(deltas[: BLOCK * FRAMES_PER_TOKEN].float().cpu())
        return torch.cat(parts)

    def decode_chunked(self, codes: Tensor, blend: str = "linear") -> Tensor:
        """Deltas (8S, 5K) on the CPU of one sequence (streams, S), in windows as in training.

        Windows of 12 codes are decoded by themselves and blended, see
        `angie.motion.windows.BLENDS`, so that no frame sees more context than in training, and
        memory does not grow with S.
        """
        frames, window = codes.shape[-1] * FRAMES_PER_TOKEN, WINDOW_TOKENS * FRAMES_PER_TOKEN

        def compute(starts: list[int], size: int = window) -> Tensor:
            first, tokens = (
                [start // FRAMES_PER_TOKEN for start in starts],
                size // FRAMES_PER_TOKEN,
            )
            return self.decode(torch.stack([codes[:, at : at + tokens] for at in first]))

        return cross_fade(frames, window, compute, blend)

    def start_codes(self, window: int = WINDOW_TOKENS) -> Tensor:
        """Codes (streams,) of a person who does not move.

        The first of a window of zero deltas; in the context of clips the middle one.
        """
        frames, channels = window * FRAMES_PER_TOKEN, sum(self.config.channels)
        place = 0 if self.config.context == "window" else window // 2
        return self.encode(torch.zeros(1, frames, channels, device=self.mean.device))[0, :, place]


class DirectMotion(nn.Module):
    """Onset features to normalised deltas."""

    mean: Tensor

    def __init__(self, vq: VQConfig, gpt: GPTConfig, speakers: int = 1) -> None:
        super().__init__()
        self.config = vq
        sizes = replace(gpt, codes=vq.code_width, block=WINDOW_TOKENS, streams=vq.streams)
        self.transformer = CoSpeechGPT(sizes, speakers)
        self.decoders = nn.ModuleList(
            Decoder(channels, vq.width, vq.code_width) for channels in vq.channels
        )
        self.register_buffer("mean", torch.zeros(sum(vq.channels)))

    def forward(self, onset: Tensor, speaker: Tensor | None = None) -> Tensor:
        """Normalised deltas (B, 8S, 5K) of standardised onset features (B, S, 426), S <= 12."""
        batch, steps, _ = onset.shape
        blank = torch.zeros(
            batch, self.config.streams, steps, dtype=torch.int64, device=onset.device
        )
        latent = self.transformer(blank, onset, speaker)  # (B, streams, S, code_width)
        parts = zip(self.decoders, latent.unbind(1), strict=True)
        return torch.cat([decoder(part) for decoder, part in parts], dim=-1)

    @torch.no_grad()
    def predict(self, onset: Tensor, speaker: int | None = None, blend: str = "linear") -> Tensor:
        """Normalised deltas (8S, 5K) on the CPU of any length of sound (S, 426).

        Windows of 12 tokens are computed by themselves and blended, see
        `angie.motion.windows.BLENDS`.
        """
        device = self.mean.device
        frames, window = len(onset) * FRAMES_PER_TOKEN, WINDOW_TOKENS * FRAMES_PER_TOKEN

        def compute(starts: list[int], size: int = window) -> Tensor:
            first, tokens = (
                [start // FRAMES_PER_TOKEN for start in starts],
                size // FRAMES_PER_TOKEN,
            )
            sound = torch.stack([onset[at : at + tokens] for at in first]).to(device)
            who = None if speaker is None else torch.full((len(first),), speaker, device=device)
            return self(sound, who)

        return cross_fade(frames, window, compute, blend)
