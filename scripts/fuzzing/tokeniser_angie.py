"""Training of ANGIE's tokeniser on motion that teaches nothing: still, far away, or one jump."""

from collections.abc import Iterator

import torch
from torch import Tensor

from angie.generators.angie.tokenizer import VQConfig, VQMotionExtractor


def hostile_training(steps: int) -> Iterator[tuple[str, Tensor]]:
    """Every loss of a tokeniser of one code, then its weights, each with a name."""
    vq = VQMotionExtractor(VQConfig(regions=2, width=16, codes=1, code_width=8))
    optimizer = torch.optim.Adam(vq.parameters(), 1e-3)
    for step in range(steps):
        deltas = torch.zeros(4, 96, 10)
        if step % 3 == 1:
            deltas += torch.randn(4, 1, 10) * 1e4
        elif step % 3 == 2:
            deltas[:, step % 96] = 1e6
        made = vq(deltas)
        loss = (made.deltas - deltas).abs().mean() + made.commitment + made.latent
        yield f"tokeniser's loss at step {step}", loss.detach()
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(vq.parameters(), 1.0)
        optimizer.step()
    for name, values in vq.state_dict().items():
        yield f"tokeniser: {name}", values
