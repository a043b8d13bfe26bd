"""Self-reconstruction: every frame of a clip from its first (MRAA's protocol)."""

from dataclasses import asdict, dataclass

import numpy as np
import torch

from data_prep.dataset import Clip, Dataset
from mraa.renderer import Renderer, from_pixels


@dataclass(frozen=True)
class Reconstruction:
    """Mean distances to the truth in [0, 1]; `copy_` is the first frame shown throughout."""

    frames: int
    l1: float
    psnr: float
    copy_l1: float
    copy_psnr: float

    def as_dict(self) -> dict[str, float]:
        """Plain numbers for a report."""
        return {k: round(v, 5) for k, v in asdict(self).items()}


@torch.no_grad()
def reconstruct(
    renderer: Renderer, dataset: Dataset, clips: list[Clip], *, stride: int = 10, batch: int = 4
) -> Reconstruction:
    """Render every `stride`-th frame of clips from their first frame and compare.

    PSNR is that of the mean squared error of a frame, averaged over frames, in decibels.
    """
    l1s: list[tuple[float, float]] = []
    mses: list[tuple[float, float]] = []
    renderer.eval()
    for clip in clips:
        store = dataset.frames(clip)
        first = from_pixels(torch.from_numpy(store[0])[None])
        numbers = list(range(stride, len(store), stride))
        for start in range(0, len(numbers), batch):
            pixels = np.stack([store[i] for i in numbers[start : start + batch]])
            driving = from_pixels(torch.from_numpy(pixels))
            source = first.expand(len(driving), -1, -1, -1)
            prediction, _ = renderer(
                source,
                renderer.estimator(source),
                renderer.estimator(driving),
                renderer.background(source, driving),
            )
            for made, copied, true in zip(prediction, source, driving, strict=True):
                l1s.append((float((made - true).abs().mean()), float((copied - true).abs().mean())))
                mses.append(
                    (float(((made - true) ** 2).mean()), float(((copied - true) ** 2).mean()))
                )
    l1, copy_l1 = np.mean(l1s, axis=0)
    psnr, copy_psnr = np.mean(-10 * np.log10(np.maximum(mses, 1e-10)), axis=0)
    return Reconstruction(len(l1s), float(l1), float(psnr), float(copy_l1), float(copy_psnr))
