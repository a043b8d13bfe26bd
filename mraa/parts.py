"""What a rendered frame is made of."""

from dataclasses import dataclass

import numpy as np
from torch import Tensor


@dataclass(frozen=True)
class Parts:
    """What frames are made of, for those who blend the photo in at another size."""

    flow: Tensor
    """(b, h, w, 2) float32 source coordinates (x, y) in [-1, 1]."""
    occlusion: Tensor
    """(b, 1, h, w) float32 in [0, 1]; 1 where the source shows what is needed."""
    painted: Tensor
    """(b, 3, H, W) float32 in [0, 1], the generated picture before the photo is blended in."""
    frames: np.ndarray
    """(b, H, W, 3) uint8 RGB, the finished frames."""
