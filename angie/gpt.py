"""The co-speech GPT: the next pair of motion codes from the codes so far and the sound.

ANGIE (NeurIPS 2022), section 3.3, with the cross-conditional causal attention that it takes from
Bailando: three blocks of tokens (sound, shift codes, Cholesky codes), in which step s sees the
steps up to s of all three blocks.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from angie.sampling import Sampling, draw
from angie.windows import WINDOW_TOKENS
from data_prep.features import ONSET_SIZE

BLOCKS = 3
"""Sound, shift codes, Cholesky codes."""


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
    """

    codes: int = 512
    onset: int = ONSET_SIZE
    width: int = 768
    heads: int = 12
    layers: int = 12
    block: int = WINDOW_TOKENS - 1
    dropout: float = 0.1


class CausalAttention(nn.Module):
    """Self-attention over three blocks of S steps, causal in the steps."""

    def __init__(self, width: int, heads: int, dropout: float) -> None:
        super().__init__()
        if width % heads:
            raise ValueError(f"width {width} is not a multiple of {heads} heads")
        self.heads, self.rate = heads, dropout
        self.mix = nn.Linear(width, 3 * width)
        self.out = nn.Linear(width, width)
        self.dropout = nn.Dropout(dropout)

    def forward(self, tokens: Tensor, mask: Tensor) -> Tensor:
        """Tokens (B, 3S, D) and mask (3S, 3S), true where attention is allowed."""
        query, key, value = (
            part.unflatten(-1, (self.heads, -1)).transpose(1, 2)  # (B, heads, 3S, D / heads)
            for part in self.mix(tokens).chunk(3, dim=-1)
        )
        mixed = functional.scaled_dot_product_attention(
            query, key, value, attn_mask=mask, dropout_p=self.rate if self.training else 0.0
        )
        return self.dropout(self.out(mixed.transpose(1, 2).flatten(-2)))


class Layer(nn.Module):
    """Pre-norm transformer layer."""

    def __init__(self, width: int, heads: int, dropout: float) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(width)
        self.attention = CausalAttention(width, heads, dropout)
        self.norm2 = nn.LayerNorm(width)
        self.mlp = nn.Sequential(
            nn.Linear(width, 4 * width),
            nn.GELU(),
            nn.Linear(4 * width, width),
            nn.Dropout(dropout),
        )

    def forward(self, tokens: Tensor, mask: Tensor) -> Tensor:
        """Tokens (B, 3S, D) to the same shape."""
        tokens = tokens + self.attention(self.norm1(tokens), mask)
        return tokens + self.mlp(self.norm2(tokens))


class CoSpeechGPT(nn.Module):
    """Logits of the next codes of both streams.

    Args:
        config: architecture.
    """

    def __init__(self, config: GPTConfig) -> None:
        super().__init__()
        self.config = config
        width, dropout = config.width, config.dropout
        self.sound = nn.Linear(config.onset, width)
        self.shift = nn.Embedding(config.codes, width)
        self.cholesky = nn.Embedding(config.codes, width)
        self.positions = nn.Parameter(torch.zeros(1, BLOCKS * config.block, width))
        self.dropout = nn.Dropout(dropout)
        self.layers = nn.ModuleList(
            Layer(width, config.heads, dropout) for _ in range(config.layers)
        )
        self.norm = nn.LayerNorm(width)
        self.shift_head = nn.Linear(width, config.codes, bias=False)
        self.cholesky_head = nn.Linear(width, config.codes, bias=False)
        self.apply(_initialise)
        nn.init.normal_(self.positions, std=0.02)

    def forward(self, codes: Tensor, onset: Tensor) -> Tensor:
        """Predict the code pair that follows each step.

        Args:
            codes: (B, 2, S) int64 in [0, V), shift stream first; 1 <= S <= block.
            onset: (B, S, 426) standardised features of the target steps: row s is the sound of
                the step whose codes are predicted from codes[..., : s + 1].

        Returns:
            (B, 2, S, V) logits; those of step s depend on nothing later than s.

        Raises:
            ValueError: shapes that do not fit.
        """
        batch, streams, steps = codes.shape
        if streams != 2 or not 1 <= steps <= self.config.block:
            raise ValueError(
                f"codes are (B, 2, S) with S up to {self.config.block}, not {tuple(codes.shape)}"
            )
        if onset.shape != (batch, steps, self.config.onset):
            raise ValueError(f"onset of {tuple(codes.shape)} codes is {tuple(onset.shape)}")
        tokens = torch.stack(
            [self.sound(onset), self.shift(codes[:, 0]), self.cholesky(codes[:, 1])], dim=1
        )
        places = self.positions.unflatten(1, (BLOCKS, self.config.block))[:, :, :steps]
        tokens = self.dropout(tokens + places).flatten(1, 2)  # (B, 3S, D)
        causal = torch.ones(steps, steps, dtype=torch.bool, device=codes.device).tril()
        mask = causal.repeat(BLOCKS, BLOCKS)
        for layer in self.layers:
            tokens = layer(tokens, mask)
        _, shift, cholesky = self.norm(tokens).chunk(BLOCKS, dim=1)
        return torch.stack([self.shift_head(shift), self.cholesky_head(cholesky)], dim=1)

    @staticmethod
    def loss(logits: Tensor, targets: Tensor) -> Tensor:
        """Cross-entropy of both streams, added: logits (B, 2, S, V), targets (B, 2, S)."""
        shift, cholesky = (
            functional.cross_entropy(
                logits[:, stream].flatten(0, 1).float(), targets[:, stream].flatten()
            )
            for stream in range(2)
        )
        return shift + cholesky

    @torch.no_grad()
    def generate(
        self,
        start: Tensor,
        onset: Tensor,
        sampling: Sampling,
        generator: torch.Generator,
        voiced: Tensor | None = None,
    ) -> Tensor:
        """Continue a sequence of codes over all the sound, with a sliding window.

        The last `block` codes are seen, and their positions restart at zero, as in training; the
        cost is linear in the length.

        Args:
            start: (2, P) int64, the first P >= 1 code pairs.
            onset: (S, 426) standardised onset features of all steps.
            sampling: how to choose a code.
            generator: source of randomness, on the CPU.
            voiced: (S,) bool, steps with sound, where the repeat guard may act; None: all.

        Returns:
            (2, S) int64 codes on the CPU; the first are `start`.
        """
        steps, block = len(onset), self.config.block
        codes = start.cpu()[:, :steps]
        device = self.positions.device
        onset = onset.to(device)
        for step in range(codes.shape[1], steps):
            first = max(0, step - block)
            seen = codes[None, :, first:step].to(device)
            logits = self(seen, onset[None, first + 1 : step + 1])[0, :, -1]  # (2, V)
            guard = voiced is None or bool(voiced[step])
            pair = draw(logits.float().cpu(), codes, sampling, generator, guard)
            codes = torch.cat([codes, pair[:, None]], dim=1)
        return codes


def _initialise(module: nn.Module) -> None:
    if isinstance(module, nn.Linear | nn.Embedding):
        nn.init.normal_(module.weight, std=0.02)
    if isinstance(module, nn.Linear) and module.bias is not None:
        nn.init.zeros_(module.bias)
