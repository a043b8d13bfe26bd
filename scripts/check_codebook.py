"""Which entries of a codebook restart, and what stays in use, on clusters that do not move.

    python scripts/check_codebook.py [--steps 2000]

As many clusters as codes (512), 384 vectors a step as in ANGIE (32 windows of 12 tokens), drawn
evenly or by Zipf's law: an entry gets 0.75 vectors a step on average. A codebook that finds a
cluster for each entry needs no restarts any more. What is printed of the last quarter of the steps:
entries that restarted a step, and the perplexity of the codes against that of the clusters.
"""

import argparse

import torch
from torch import Tensor

from angie.layers.vqvae import Codebook
from data_prep.errors import call_script

CODES, WIDTH, VECTORS = 512, 32, 384
RATE = 3e-5
"""Of Adam, under the loss update (ANGIE, section 4)."""

WAYS = (("ema", 1.0), ("ema", 0.3), ("ema", 0.1), ("ema", 0.03), ("ema", 0.0), ("loss", 0.0))


def measure(update: str, below: float, shares: Tensor, steps: int) -> tuple[float, float]:
    """Restarts a step and perplexity of a codebook in the last quarter of the steps."""
    torch.manual_seed(0)
    centres = 3 * torch.randn(CODES, WIDTH)
    book = Codebook(CODES, WIDTH, update, restart_below=below).train()
    entries = list(book.parameters())
    adam = torch.optim.Adam(entries, RATE) if entries else None
    restarts, counts = 0, torch.zeros(CODES)
    for step in range(steps):
        chosen = shares.multinomial(VECTORS, replacement=True)
        values = (centres[chosen] + 0.1 * torch.randn(VECTORS, WIDTH)).view(32, 12, WIDTH)
        result = book(values)
        if adam is not None:
            adam.zero_grad()
            result.latent.backward()
            adam.step()
        if step >= steps * 3 // 4:
            restarts += int(book.restarted)
            counts += torch.bincount(result.codes.flatten(), minlength=CODES)
    share = counts / counts.sum()
    return restarts / (steps - steps * 3 // 4), float(torch.special.entr(share).sum().exp())


def main() -> None:
    """Print a row for each way of updating."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=2000)
    steps = parser.parse_args().steps
    even = torch.full((CODES,), 1 / CODES)
    zipf = 1 / torch.arange(1, CODES + 1)
    for name, shares in (("even", even), ("Zipf", zipf / zipf.sum())):
        most = float(torch.special.entr(shares).sum().exp())
        print(f"{name} clusters, perplexity {most:.0f}")
        for update, below in WAYS:
            restarts, perplexity = measure(update, below, shares, steps)
            print(
                f"  {update:4} restart_below={below:<5g} {restarts:7.2f} restarts a step, "
                f"perplexity {perplexity:.0f}",
                flush=True,
            )


if __name__ == "__main__":
    call_script(main)
