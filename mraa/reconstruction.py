"""Self-reconstruction: every frame of a clip from its first (MRAA's protocol)."""

from dataclasses import asdict, dataclass

import numpy as np
import torch
from torch import Tensor

from data_prep.dataset import Clip, Dataset
from mraa.perceptual import PerceptualDistance, score
from mraa.renderer import Renderer, from_pixels


@dataclass(frozen=True)
class Reconstruction:
    """Mean distances to the truth over frames; `copy_` is the first frame shown throughout.

    Each as `mraa.perceptual` defines it, `backend` being what `perceptual` was measured by.
    """

    frames: int
    backend: str
    l1: float
    psnr: float
    ssim: float
    perceptual: float
    copy_l1: float
    copy_psnr: float
    copy_ssim: float
    copy_perceptual: float

    def as_dict(self) -> dict[str, float | str]:
        """Plain values for a report."""
        return {k: round(v, 5) if isinstance(v, float) else v for k, v in asdict(self).items()}

    def __str__(self) -> str:
        return (
            f"L1 {self.l1:.4f} (copying the source {self.copy_l1:.4f}), "
            f"PSNR {self.psnr:.2f} dB ({self.copy_psnr:.2f}), "
            f"SSIM {self.ssim:.4f} ({self.copy_ssim:.4f}), "
            f"perceptual by {self.backend} {self.perceptual:.2f} ({self.copy_perceptual:.2f})"
        )


def spread(clips: list[Clip], most: int = 4000) -> list[Clip]:
    """Every n-th clip, by the smallest n that leaves at most `most` frames; never less than one.

    What `angie train` reports of a renderer is measured on these of the test clips.
    """
    for n in range(1, len(clips)):
        if sum(clip.n_frames for clip in clips[::n]) <= most:
            return clips[::n]
    return clips[:1]


@torch.no_grad()
def reconstruct(
    renderer: Renderer,
    dataset: Dataset,
    clips: list[Clip],
    *,
    stride: int = 10,
    batch: int = 4,
    perceptual: PerceptualDistance | None = None,
) -> Reconstruction:
    """Render every `stride`-th frame of clips from their first frame and compare.

    Args:
        renderer: on any device; left in eval mode.
        dataset: where the clips are.
        clips: at least one of more than `stride` frames.
        stride: frames from one that is compared to the next.
        batch: frames at once.
        perceptual: what measures the perceptual distance; without, the fixed random network.

    Raises:
        ValueError: no frame to compare.
    """
    device = next(renderer.parameters()).device
    perceptual = (perceptual or PerceptualDistance()).to(device)
    renderer.eval()
    rows: list[Tensor] = []
    for clip in clips:
        store = dataset.frames(clip)
        first = from_pixels(torch.from_numpy(store[0])[None]).to(device)
        regions = renderer.estimator(first)
        numbers = list(range(stride, len(store), stride))
        for start in range(0, len(numbers), batch):
            pixels = np.stack([store[i] for i in numbers[start : start + batch]])
            truth = from_pixels(torch.from_numpy(pixels)).to(device)
            source = first.expand(len(truth), -1, -1, -1)
            made, _ = renderer(
                source,
                regions.repeat(len(truth)),
                renderer.estimator(truth),
                renderer.background(source, truth),
            )
            scores = [score(image, truth, perceptual) for image in (made.float(), source)]
            columns = [v for s in scores for v in (s.l1, s.psnr, s.ssim, s.perceptual)]
            rows.append(torch.stack(columns, dim=1).double().cpu())  # (B, 8)
    if not rows:
        raise ValueError(f"no clip is longer than {stride} frames")
    table = torch.cat(rows)
    return Reconstruction(len(table), perceptual.backend, *table.mean(0).tolist())
