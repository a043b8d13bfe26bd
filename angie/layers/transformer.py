"""A pre-norm transformer over blocks of tokens, with the keys and values of a window kept."""

import torch
from torch import Tensor, nn
from torch.nn import functional


class KeyValues:
    """Keys and values of the steps that a window holds so far, in every layer.

    Valid while positions stay: when the window moves, every position changes and all of it has
    to be computed again.

    Args:
        layers: of the transformer.
        batch: sequences B.
        heads: of each layer.
        blocks: tokens of a step: sound and streams of codes, each a block of the window.
        block: steps of a window.
        size: numbers of a head, D / heads.
        device: where it lies.
    """

    def __init__(
        self, layers: int, batch: int, heads: int, blocks: int, block: int, size: int,
        device: torch.device,
    ) -> None:  # fmt: skip
        self.values = torch.empty((layers, 2, batch, heads, blocks * block, size), device=device)
        self.blocks, self.block = blocks, block
        self.steps = 0

    @property
    def full(self) -> bool:
        """Whether the window has no room for another step."""
        return self.steps == self.block

    def extend(self, layer: int, key: Tensor, value: Tensor) -> tuple[Tensor, Tensor]:
        """Add tokens (B, heads, n, D / heads) to a layer; all it holds, the new ones last."""
        first = self.steps * self.blocks
        last = first + key.shape[2]
        keys, values = self.values[layer].unbind()
        keys[:, :, first:last], values[:, :, first:last] = key, value
        return keys[:, :, :last], values[:, :, :last]


class CausalAttention(nn.Module):
    """Self-attention over blocks of S steps, causal in the steps."""

    def __init__(self, width: int, heads: int, dropout: float) -> None:
        super().__init__()
        self.heads, self.rate = heads, dropout
        self.mix = nn.Linear(width, 3 * width)
        self.out = nn.Linear(width, width)
        self.dropout = nn.Dropout(dropout)

    def forward(
        self,
        tokens: Tensor,
        mask: Tensor | None,
        cache: KeyValues | None = None,
        layer: int = 0,
        wanted: Tensor | None = None,
    ) -> Tensor:
        """Tokens (B, n, D) and mask (n, n), true where attention is allowed, None everywhere.

        With a cache the tokens also see all that it holds of this layer, and join it. `wanted`
        are the places (m,) of the tokens whose result (B, m, D) is needed; None is all.
        """
        query, key, value = (
            part.unflatten(-1, (self.heads, -1)).transpose(1, 2)  # (B, heads, n, D / heads)
            for part in self.mix(tokens).chunk(3, dim=-1)
        )
        if cache is not None:
            key, value = cache.extend(layer, key, value)
        if wanted is not None:
            query, mask = query[:, :, wanted], None if mask is None else mask[wanted]
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
            nn.Linear(width, 4 * width), nn.GELU(), nn.Linear(4 * width, width), nn.Dropout(dropout)
        )

    def forward(
        self,
        tokens: Tensor,
        mask: Tensor | None,
        cache: KeyValues | None = None,
        layer: int = 0,
        wanted: Tensor | None = None,
    ) -> Tensor:
        """Tokens (B, n, D) to the same shape, or to (B, m, D); see `CausalAttention`."""
        mixed = self.attention(self.norm1(tokens), mask, cache, layer, wanted)
        tokens = (tokens if wanted is None else tokens[:, wanted]) + mixed
        return tokens + self.mlp(self.norm2(tokens))


def initialise(module: nn.Module) -> None:
    """Weights of linear layers and embeddings as GPT-2 has them: deviation 0.02, no bias."""
    if isinstance(module, nn.Linear | nn.Embedding):
        nn.init.normal_(module.weight, std=0.02)
    if isinstance(module, nn.Linear) and module.bias is not None:
        nn.init.zeros_(module.bias)
