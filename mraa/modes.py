"""Whose motion goes onto whom: standard, relative, and by disentanglement (MRAA, section 3.4)."""

import numpy as np
from scipy.spatial import ConvexHull, QhullError
from torch import Tensor

from mraa.affine import inverse
from mraa.regions import Regions


def hull_scale(source: Tensor, driving: Tensor) -> float:
    """Ratio of the square roots of the areas that two region sets (K, 2) span.

    Returns 1 where a set is too degenerate to span an area.
    """
    try:
        areas = [ConvexHull(x.detach().cpu().numpy()).volume for x in (source, driving)]
    except (QhullError, ValueError):
        return 1.0
    return float(np.sqrt(areas[0]) / np.sqrt(areas[1]))


def relative_regions(source: Regions, driving: Regions, initial: Regions) -> Regions:
    """The driving motion since its first frame, applied to the source.

    `mu = mu_s + scale (mu_d - mu_d0)`, `A = A_d A_d0^-1 A_s`, `C = A A^T`.

    Args:
        source: regions (1, K) of the source image.
        driving: regions (B, K) of driving frames.
        initial: regions (1, K) of the first driving frame.
    """
    scale = hull_scale(source.shift[0], initial.shift[0])
    shift = source.shift + scale * (driving.shift - initial.shift)
    affine = driving.affine @ inverse(initial.affine) @ source.affine
    return Regions(shift, affine @ affine.mT, affine)
