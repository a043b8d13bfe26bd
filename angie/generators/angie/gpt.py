"""The co-speech GPT: the next codes of the motion from the codes so far and the sound.

ANGIE (NeurIPS 2022), section 3.3, with the cross-conditional causal attention that it takes from
Bailando: three blocks of tokens (sound, shift codes, Cholesky codes), in which step s sees the
steps up to s of all three blocks.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from angie.layers.transformer import KeyValues, Layer, initialise
from angie.motion.windows import WINDOW_TOKENS
from data_prep.speech.features import ONSET_SIZE, SOUND_SIZES


@dataclass(frozen=True)
class GPTConfig:
    """Architecture of the co-speech GPT; the defaults are the paper's.

    Attributes:
        codes: entries V of each codebook.
        onset: numbers of an onset feature.
        width: of the tokens.
        heads: attention heads.
        layers: transformer layers; the paper does not say, Bailando's are 6 base and 6 head.
        block: most steps seen at once; 11 steps predict codes 2 to 12 of a window of 96 frames.
        dropout: of embeddings, attention and layers.
        streams: code streams; 2 are shift and Cholesky factor, 1 is shift alone (keypoints), 3 are
            those of the naive scheme.
        sound: feature of the tokens, of which `onset` is the size: "onset" (section 4.1), of the
            whole recording, or "onset_causal" (114), of sound as it comes; not in the paper.
        joint: one model for several speakers: an embedding of the speaker, and one of anyone
            for a speaker who is not known, is added to the tokens of the sound.
    """

    codes: int = 512
    onset: int = ONSET_SIZE
    width: int = 768
    heads: int = 12
    layers: int = 12
    block: int = WINDOW_TOKENS - 1
    dropout: float = 0.1
    streams: int = 2
    joint: bool = False
    sound: str = "onset"

    def __post_init__(self) -> None:
        if self.streams not in (1, 2, 3):
            raise ValueError(f"there are 1 to 3 streams of codes, not {self.streams}")
        if self.sound not in SOUND_SIZES:
            raise ValueError(f"sound is one of {', '.join(SOUND_SIZES)}, not {self.sound!r}")
        sizes = (self.codes, self.onset, self.width, self.heads, self.layers, self.block)
        if min(sizes) < 1:
            raise ValueError("codes, onset, width, heads, layers and block must be positive")
        if self.width % self.heads:
            raise ValueError(f"width {self.width} is not a multiple of {self.heads} heads")
        if not 0 <= self.dropout < 1:
            raise ValueError(f"dropout lies between 0 and 1, not {self.dropout:g}")

    @property
    def blocks(self) -> int:
        """Blocks of tokens: the sound and each stream of codes."""
        return 1 + self.streams


class CoSpeechGPT(nn.Module):
    """Logits of the next codes of all streams."""

    def __init__(self, config: GPTConfig, speakers: int = 1) -> None:
        super().__init__()
        self.config = config
        width, dropout = config.width, config.dropout
        self.sound = nn.Linear(config.onset, width)
        self.shift = nn.Embedding(config.codes, width)
        if config.streams > 1:
            self.cholesky = nn.Embedding(config.codes, width)
        if config.streams > 2:
            self.affine = nn.Embedding(config.codes, width)
        self.positions = nn.Parameter(torch.zeros(1, config.blocks * config.block, width))
        self.dropout = nn.Dropout(dropout)
        self.layers = nn.ModuleList(
            Layer(width, config.heads, dropout) for _ in range(config.layers)
        )
        self.norm = nn.LayerNorm(width)
        self.shift_head = nn.Linear(width, config.codes, bias=False)
        if config.streams > 1:
            self.cholesky_head = nn.Linear(width, config.codes, bias=False)
        if config.streams > 2:
            self.affine_head = nn.Linear(width, config.codes, bias=False)
        self.speaker = nn.Embedding(speakers + 1, width) if config.joint else None
        self.apply(initialise)
        nn.init.normal_(self.positions, std=0.02)

    def forward(self, codes: Tensor, onset: Tensor, speaker: Tensor | None = None) -> Tensor:
        """Predict the codes that follow each step.

        Args:
            codes: (B, streams, S) int64 in [0, V), shift stream first; 1 <= S <= block.
            onset: (B, S, 426) standardised features of the target steps: row s is the sound of
                the step whose codes are predicted from codes[..., : s + 1].
            speaker: (B,) int64 places in the training set's speakers, P for anyone; None is
                anyone. Seen by joint models alone.

        Returns:
            (B, streams, S, V) logits; those of step s depend on nothing later than s.

        Raises:
            ValueError: shapes that do not fit.
        """
        steps = codes.shape[-1]
        tokens = self.dropout(self._embed(codes, onset, speaker, 0))
        mask = self._mask(steps, codes.device)
        for layer in self.layers:
            tokens = layer(tokens, mask)
        return self._logits(tokens.unflatten(1, (self.config.blocks, steps)))

    def cache(self, batch: int) -> KeyValues:
        """An empty window for `batch` sequences, for `advance`."""
        c = self.config
        size, device = c.width // c.heads, self.positions.device
        return KeyValues(c.layers, batch, c.heads, c.blocks, c.block, size, device)

    @torch.no_grad()
    def advance(
        self, codes: Tensor, onset: Tensor, cache: KeyValues, speaker: Tensor | None = None
    ) -> Tensor:
        """Predict the codes after the given steps, which follow those in the cache.

        Equal to the last step of `forward` over all steps of the window, but only the new ones
        are computed.

        Args:
            codes: (B, streams, n) int64; one step, or several into an empty cache.
            onset: (B, n, 426) as in `forward`.
            cache: what the window holds; it takes the new steps up.
            speaker: as in `forward`.

        Returns:
            (B, streams, V) logits.

        Raises:
            ValueError: shapes that do not fit, or more steps than the block.
        """
        steps = codes.shape[-1]
        if cache.steps and steps > 1:
            raise ValueError("several steps at once fit into an empty cache alone")
        tokens = self._embed(codes, onset, speaker, cache.steps)
        mask = self._mask(steps, codes.device) if steps > 1 else None
        # of the last layer nothing is needed but the last step
        last = torch.arange(steps - 1, tokens.shape[1], steps, device=codes.device)
        for place, layer in enumerate(self.layers):
            final = place + 1 == len(self.layers)
            tokens = layer(tokens, mask, cache, place, last if final else None)
        cache.steps += steps
        return self._logits(tokens[:, :, None])[:, :, 0]

    def _embed(self, codes: Tensor, onset: Tensor, speaker: Tensor | None, first: int) -> Tensor:
        """Tokens (B, blocks * n, D) of steps [first, first + n) of a window, block by block."""
        config = self.config
        batch, streams, steps = codes.shape
        if streams != config.streams or not 1 <= steps <= config.block - first:
            raise ValueError(
                f"codes are (B, {config.streams}, S) with S up to {config.block}, "
                f"not {tuple(codes.shape)} after {first}"
            )
        if onset.shape != (batch, steps, config.onset):
            raise ValueError(f"onset of {tuple(codes.shape)} codes is {tuple(onset.shape)}")
        sound = self.sound(onset)
        if self.speaker is not None:
            anyone = torch.full((batch,), self.speaker.num_embeddings - 1, device=codes.device)
            sound = sound + self.speaker(anyone if speaker is None else speaker)[:, None]
        blocks = [sound, self.shift(codes[:, 0])]
        if streams > 1:
            blocks.append(self.cholesky(codes[:, 1]))
        if streams > 2:
            blocks.append(self.affine(codes[:, 2]))
        places = self.positions.unflatten(1, (config.blocks, config.block))
        tokens = torch.stack(blocks, dim=1) + places[:, :, first : first + steps]
        return tokens.flatten(1, 2)

    def _mask(self, steps: int, device: torch.device) -> Tensor:
        """(blocks * S, blocks * S) bool: the causal mask of one block, tiled."""
        causal = torch.ones(steps, steps, dtype=torch.bool, device=device).tril()
        return causal.repeat(self.config.blocks, self.config.blocks)

    def _logits(self, tokens: Tensor) -> Tensor:
        """(B, streams, S, V) of tokens (B, blocks, S, D)."""
        tokens = self.norm(tokens)
        logits = [self.shift_head(tokens[:, 1])]
        if self.config.streams > 1:
            logits.append(self.cholesky_head(tokens[:, 2]))
        if self.config.streams > 2:
            logits.append(self.affine_head(tokens[:, 3]))
        return torch.stack(logits, dim=1)

    @staticmethod
    def loss(logits: Tensor, targets: Tensor) -> Tensor:
        """Cross-entropy of all streams, added: logits (B, streams, S, V), codes (B, streams, S)."""
        losses = [
            functional.cross_entropy(
                logits[:, stream].flatten(0, 1).float(), targets[:, stream].flatten()
            )
            for stream in range(targets.shape[1])
        ]
        return torch.stack(losses).sum()
