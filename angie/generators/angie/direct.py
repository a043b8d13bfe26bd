"""Motion regressed from the sound without codes: the row "no quantisation" of Table 3.

The same transformer as the co-speech GPT; in place of the logits of codes its heads give one
latent vector a token and stream, which the decoders of the VQ motion extractor turn into deltas.
No codes come in: every step of a stream is the same learned token. Trained end to end.
"""

from dataclasses import replace

import torch
from torch import Tensor, nn

from angie.generators.angie.gpt import CoSpeechGPT, GPTConfig
from angie.generators.angie.tokenizer import VQConfig
from angie.layers.vqvae import Decoder
from angie.motion.windows import WINDOW_TOKENS, cross_fade
from data_prep.rates import FRAMES_PER_TOKEN


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
        size = min(WINDOW_TOKENS, len(onset))
        device = self.mean.device

        def compute(starts: list[int]) -> Tensor:
            first = [start // FRAMES_PER_TOKEN for start in starts]
            sound = torch.stack([onset[at : at + size] for at in first]).to(device)
            who = None if speaker is None else torch.full((len(first),), speaker, device=device)
            return self(sound, who)

        frames, window = len(onset) * FRAMES_PER_TOKEN, WINDOW_TOKENS * FRAMES_PER_TOKEN
        return cross_fade(frames, window, compute, blend)
