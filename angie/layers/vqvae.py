"""VQ autoencoder over time, shared by generators that quantise motion.

Convolutional encoder and decoder, and a learned codebook: nearest entry, straight-through gradient,
exponential moving averages.
"""

from dataclasses import dataclass

import torch
import torch.distributed as distributed
from torch import Tensor, nn
from torch.nn import functional

from data_prep.rates import FRAMES_PER_TOKEN

DILATIONS = (1, 3, 9)


HALVINGS = FRAMES_PER_TOKEN.bit_length() - 1
"""Strided convolutions that make one token of 8 frames."""


class ResidualBlock(nn.Module):
    """x + conv1(relu(conv3 of a dilation(relu(x)))), no normalisation."""

    def __init__(self, width: int, dilation: int) -> None:
        super().__init__()
        self.wide = nn.Conv1d(width, width, 3, padding=dilation, dilation=dilation)
        self.narrow = nn.Conv1d(width, width, 1)

    def forward(self, values: Tensor) -> Tensor:
        """(B, W, T) to the same shape."""
        return values + self.narrow(self.wide(values.relu()).relu())


class Encoder(nn.Module):
    """Deltas (B, T, C) to latent vectors (B, T // 8, code_width)."""

    def __init__(self, channels: int, width: int, code_width: int) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for stage in range(HALVINGS):
            layers.append(nn.Conv1d(width if stage else channels, width, 4, stride=2, padding=1))
            layers.extend(ResidualBlock(width, dilation) for dilation in DILATIONS)
        self.layers = nn.Sequential(*layers, nn.Conv1d(width, code_width, 3, padding=1))

    def forward(self, deltas: Tensor) -> Tensor:
        """Encode; frames beyond a multiple of 8 are not seen."""
        length = deltas.shape[1] // FRAMES_PER_TOKEN * FRAMES_PER_TOKEN
        return self.layers(deltas[:, :length].mT).mT


class Decoder(nn.Module):
    """Latent vectors (B, S, code_width) to deltas (B, 8S, C)."""

    def __init__(self, channels: int, width: int, code_width: int) -> None:
        super().__init__()
        layers: list[nn.Module] = [nn.Conv1d(code_width, width, 3, padding=1)]
        for _ in range(HALVINGS):
            layers.extend(ResidualBlock(width, dilation) for dilation in reversed(DILATIONS))
            layers.append(nn.ConvTranspose1d(width, width, 4, stride=2, padding=1))
        self.layers = nn.Sequential(*layers, nn.Conv1d(width, channels, 3, padding=1))

    def forward(self, latent: Tensor) -> Tensor:
        """Decode."""
        return self.layers(latent.mT).mT


UPDATES = ("ema", "loss")

IDLE_STEPS = 100
"""With `update="loss"`, entries unused for this many steps restart, every this many steps."""

RESTART_BELOW = 0.1
"""Moving count of vectors a step below which an entry restarts under `update="ema"`.

ANGIE's 32 windows of 12 tokens give 512 entries 0.75 vectors a step each. At 1.0, Bailando's
threshold for 960 vectors, half of the entries of a codebook that has found its clusters are redrawn
at every step, for ever; at 0.1 hardly any is (`scripts/check_codebook.py`).
"""


@dataclass
class Quantized:
    """Vectors after the codebook.

    Attributes:
        values: (B, S, W) nearest entries; the gradient passes straight through to the input.
        codes: (B, S) int64, indices of the entries.
        commitment: () mean squared distance of the input to its entry, gradient to the input.
        latent: () the same distance with gradient to the entries; zero under EMA, which follows
            that gradient by itself.
    """

    values: Tensor
    codes: Tensor
    commitment: Tensor
    latent: Tensor


def _all_reduce(values: Tensor) -> Tensor:
    if distributed.is_available() and distributed.is_initialized():
        distributed.all_reduce(values)
    return values


def _broadcast(values: Tensor) -> Tensor:
    if distributed.is_available() and distributed.is_initialized():
        distributed.broadcast(values, src=0)
    return values


def _nearest(values: Tensor, entries: Tensor) -> Tensor:
    """Places (...) of the entries (V, W) nearest to vectors (..., W)."""
    return (entries.square().sum(-1) - 2 * (values @ entries.T)).argmin(-1)


def cluster(values: Tensor, count: int, rounds: int = 10) -> Tensor:
    """Centres (count, W) of vectors (n, W) by k-means from k-means++; fewer vectors are repeated.

    Random by torch's global generator, from which scikit-learn's seed is drawn; on one thread,
    because several add up their sums in the order in which they end.
    """
    from sklearn.cluster import KMeans  # slow to import
    from threadpoolctl import threadpool_limits

    if len(values) <= count:
        return values.repeat(-(-count // len(values)), 1)[:count]
    seed = int(torch.randint(2**31 - 1, ()))
    model = KMeans(count, n_init=1, max_iter=rounds, random_state=seed)
    with threadpool_limits(1):
        centres = model.fit(values.cpu().numpy()).cluster_centers_
    return torch.from_numpy(centres).to(values)


class Codebook(nn.Module):
    """V entries of W numbers (VQ-VAE with moving averages and restarts, as Jukebox and Bailando).

    The first training batch gives the first entries. Under `ema` entries are the moving averages
    of the vectors assigned to them, and an entry whose moving count falls below `restart_below`
    restarts at a random vector of the batch. Under `loss` the entries are a parameter with the
    gradient of `Quantized.latent` (ANGIE, equation 9), and every 100 steps the entries unused for
    100 steps restart: an entry in use never does. All that changes is in buffers and parameters,
    always float32; under distributed training counts and sums are added over the processes.

    Args:
        codes: entries V.
        width: numbers W of an entry.
        update: "ema" or "loss".
        decay: of the moving averages.
        restart_below: moving count of vectors a step below which an entry restarts under "ema".

    Attributes:
        restarted: entries that restarted in the last step.
    """

    entries: Tensor
    initialised: Tensor
    counts: Tensor
    sums: Tensor
    usage: Tensor
    idle: Tensor
    steps: Tensor

    def __init__(
        self,
        codes: int,
        width: int,
        update: str = "ema",
        decay: float = 0.99,
        restart_below: float = RESTART_BELOW,
    ) -> None:
        super().__init__()
        if update not in UPDATES:
            raise ValueError(f"codebook update is one of {', '.join(UPDATES)}, not {update!r}")
        if not 0 <= decay < 1:
            raise ValueError(f"decay lies between 0 and 1, not {decay}")
        self.update, self.decay, self.restart_below = update, decay, restart_below
        self.restarted = torch.zeros((), dtype=torch.int64)
        entries = torch.randn(codes, width) / width**0.5
        if update == "ema":
            self.register_buffer("entries", entries)
        else:
            self.entries = nn.Parameter(entries)
        self.register_buffer("initialised", torch.zeros((), dtype=torch.bool))
        self.register_buffer("counts", torch.ones(codes))
        self.register_buffer("sums", torch.zeros(codes, width))
        self.register_buffer("usage", torch.zeros(codes))
        self.register_buffer("idle", torch.zeros(codes, dtype=torch.int64))
        self.register_buffer("steps", torch.zeros((), dtype=torch.int64))

    def forward(self, values: Tensor) -> Quantized:
        """Quantise vectors (B, S, W); in training mode the codebook learns from them."""
        with torch.autocast(values.device.type, enabled=False):
            values = values.float()
            flat = values.detach().flatten(0, 1)
            learning = self.training and torch.is_grad_enabled()
            if learning and not bool(self.initialised):
                self._initialise(flat)
            codes = self.nearest(values)
            entries = self.dequantize(codes)
            commitment = (values - entries.detach()).square().mean()
            latent = (
                (values.detach() - entries).square().mean()
                if self.update == "loss"
                else torch.zeros_like(commitment)
            )
            if learning:
                self._learn(flat, codes.flatten())
            through = values + (entries - values).detach() if self.training else entries.detach()
            return Quantized(through, codes, commitment, latent)

    @torch.no_grad()
    def nearest(self, values: Tensor) -> Tensor:
        """Codes (B, S) int64 of the entries nearest to vectors (B, S, W)."""
        return _nearest(values.float(), self.entries.float())

    def dequantize(self, codes: Tensor) -> Tensor:
        """Entries (B, S, W) float32 of codes (B, S)."""
        return functional.embedding(codes, self.entries)

    def perplexity(self) -> Tensor:
        """Perplexity exp(H) of the moving usage of the entries, in [1, V]."""
        share = self.usage / self.usage.sum().clamp_min(1e-12)
        return torch.special.entr(share).sum().exp()

    def used(self) -> Tensor:
        """Number of entries that lately had at least a tenth of an even share of the use."""
        share = self.usage / self.usage.sum().clamp_min(1e-12)
        return (share * len(self.usage) >= 0.1).sum()

    @torch.no_grad()
    def init_entries(self, values: Tensor) -> None:
        """Take the cluster centres of vectors (n, W) as entries, in place of a first batch's."""
        centres = _broadcast(cluster(values.float(), len(self.entries)))
        shares = torch.bincount(_nearest(values.float(), centres), minlength=len(centres)).float()
        self.counts.copy_(shares * len(centres) / len(values))  # one vector a step for each
        self.entries.copy_(centres)
        self.sums.copy_(centres * self.counts[:, None])
        self.initialised.fill_(True)

    @torch.no_grad()
    def _initialise(self, flat: Tensor) -> None:
        self.entries.copy_(self._candidates(flat))
        self.sums.copy_(self.entries)
        self.counts.fill_(1)
        self.initialised.fill_(True)

    def _candidates(self, flat: Tensor) -> Tensor:
        """V random vectors of the batch; repeated with a little noise if there are fewer."""
        wanted, width = self.entries.shape
        if len(flat) < wanted:
            repeats = -(-wanted // len(flat))
            flat = flat.repeat(repeats, 1)
            flat = flat + torch.randn_like(flat) * (0.01 / width**0.5)
        chosen = flat[torch.randperm(len(flat), device=flat.device)[:wanted]]
        return _broadcast(chosen.contiguous())

    @torch.no_grad()
    def _learn(self, flat: Tensor, codes: Tensor) -> None:
        size = len(self.entries)
        batch_counts = _all_reduce(torch.bincount(codes, minlength=size).float())
        batch_sums = torch.zeros_like(self.sums).index_add_(0, codes, flat)
        self.usage.lerp_(batch_counts, 1 - self.decay)
        self.steps.add_(1)
        candidates = self._candidates(flat)
        if self.update == "ema":
            self.counts.lerp_(batch_counts, 1 - self.decay)
            self.sums.lerp_(_all_reduce(batch_sums), 1 - self.decay)
            dead = self.counts < self.restart_below
            means = self.sums / self.counts.clamp_min(1e-12).unsqueeze(-1)
            self.entries.copy_(torch.where(dead.unsqueeze(-1), candidates, means))
            self.sums.copy_(torch.where(dead.unsqueeze(-1), candidates, self.sums))
            self.counts.masked_fill_(dead, max(1.0, self.restart_below))
            self.restarted = dead.sum()
            return
        self.idle.add_(1).masked_fill_(batch_counts > 0, 0)
        due = (self.steps % IDLE_STEPS == 0) & (self.idle >= IDLE_STEPS)
        self.entries.copy_(torch.where(due.unsqueeze(-1), candidates, self.entries))
        self.idle.masked_fill_(due, 0)
        self.restarted = due.sum()
