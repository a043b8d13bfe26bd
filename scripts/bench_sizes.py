"""Quality and speed of frames at the photo's own resolution.

    python scripts/bench_sizes.py [--speaker BUNDLE] [--presenters 6] [--threads 1]

Quality: takes of the phantom that no bundle was trained on, drawn with three times the pixels.
The first frame is the photo; later frames are drawn from it with the regions that the estimator
finds in the true frames, at 512 and 1024 pixels, and compared with the true frames of that size,
beside the 256-pixel frames enlarged and the photo shown throughout. Three frames a take, at the
50th, 70th and 90th percentile of how far the joints have moved. `detail` is the mean magnitude
of the Laplacian over that of the truth.

Seam: the square put back into the whole picture; mean jump across its borders inside the picture
over that of the photo itself there, with the motion faded towards the borders and without.

Speed: milliseconds for a frame, one frame after another, without the encoder.
"""

import argparse
import time
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from angie.bundle import BUNDLE, Bundle
from data_prep.phantom.make import take
from data_prep.speaker.crop import Crop, cut_out, find_faces, speaker_crop
from mraa.fast.fullsize import FullSize
from mraa.fast.session import RenderSession
from mraa.flow import Flow
from mraa.perceptual import psnr, ssim
from mraa.renderer import Renderer, from_pixels, to_pixels

SEED, SCALE, SIZES = 77, 3, (512, 1024)


def pictures(index: int) -> tuple[list[NDArray[np.uint8]], Crop]:
    """The first and three later frames of a take, large, and the speaker's square in them."""
    shot = take(index, 0, seconds=9, seed=SEED)
    small = shot.figure.frame(0)
    crop = speaker_crop(find_faces(small)[0], *small.shape[:2])
    crop = Crop(SCALE * crop.x, SCALE * crop.y, SCALE * crop.size)
    points = shot.joints.points
    order = np.argsort(np.linalg.norm(points - points[0], axis=-1).max(1))
    frames = [0] + [int(order[int(part * len(order))]) for part in (0.5, 0.7, 0.9)]
    figure = shot.figure_at(SCALE)
    return [figure.frame(t) for t in frames], crop


@torch.no_grad()
def moved(renderer: Renderer, frames: torch.Tensor) -> tuple[Flow, torch.Tensor, torch.Tensor]:
    """Flow, painted and finished pictures of frames (b, 3, 256, 256), drawn from the first."""
    count = len(frames) - 1
    source = frames[:1].expand(count, -1, -1, -1)
    regions = renderer.estimator(source)
    flow = renderer.flow(source, regions, renderer.estimator(frames[1:]))
    features = renderer.generator.encode(source)
    painted = renderer.generator.paint(features, flow)
    return flow, painted, renderer.generator.blend(source, painted, flow)


def detail(image: NDArray[np.uint8]) -> float:
    """Mean magnitude of the Laplacian."""
    return float(np.abs(cv2.Laplacian(image.astype(np.float32), cv2.CV_32F)).mean())


def score(image: NDArray[np.uint8], truth: NDArray[np.uint8]) -> tuple[float, float, float]:
    """PSNR in decibels, SSIM and share of the detail."""
    a, b = (from_pixels(torch.from_numpy(x)[None]) for x in (image, truth))
    return float(psnr(a, b)), float(ssim(a, b)), detail(image) / detail(truth)


def seam(frames: NDArray[np.uint8], crop: Crop) -> float:
    """Mean jump across the square's borders inside of frames (b, H, W, 3), in 8-bit steps."""
    image = frames.astype(np.float32)
    height, width = image.shape[1:3]
    down, across = (slice(max(start, 0), start + crop.size) for start in (crop.y, crop.x))
    lines = []
    for x in (crop.x, crop.x + crop.size):
        if 0 < x < width:
            lines.append(np.abs(image[:, down, x] - image[:, down, x - 1]).mean())
    for y in (crop.y, crop.y + crop.size):
        if 0 < y < height:
            lines.append(np.abs(image[:, y, across] - image[:, y - 1, across]).mean())
    return float(np.mean(lines))


def quality(renderer: Renderer, presenters: int) -> None:
    """Print scores at every size, and the seam."""
    rows: dict[tuple[int, str], list[tuple[float, float, float]]] = {}
    seams = []
    corners = renderer.config.align_corners
    for index in range(presenters):
        large, crop = pictures(index)
        small = np.stack([cut_out(image, crop) for image in large])
        flow, painted, finished = moved(renderer, from_pixels(torch.from_numpy(small)))
        parts = (flow.flow, flow.occlusion, painted)
        for size in SIZES:
            true = [cut_out(image, crop, size) for image in large]
            drawn = FullSize(large[0], crop, size, align_corners=corners).frames(*parts)
            usual = to_pixels(finished).numpy()
            for made, frame, truth in zip(drawn, usual, true[1:], strict=True):
                up = np.asarray(cv2.resize(frame, (size, size), interpolation=cv2.INTER_CUBIC))
                named = {f"--size {size}": made, "256 enlarged": up, "photo": true[0]}
                for name, image in named.items():
                    rows.setdefault((size, name), []).append(score(image, truth))
        whole = FullSize(large[0], crop, crop.size, align_corners=corners, whole=True)
        faded = whole.frames(*parts)
        whole.fade_rows[:], whole.fade_columns[:] = 1, 1
        own = seam(large[0][None], crop)
        seams.append((seam(faded, crop) / own, seam(whole.frames(*parts), crop) / own))
    for (size, name), scores in rows.items():
        decibels, similarity, share = np.mean(scores, axis=0)
        print(f"{size:5d} {name:13s} {decibels:6.2f} dB  SSIM {similarity:.4f}  detail {share:.2f}")
    print("seam over the photo's own: faded {:.3f}, not faded {:.3f}".format(*np.mean(seams, 0)))


def speed(renderer: Renderer, frames: int = 48) -> None:
    """Print milliseconds a frame of rendering at each size."""
    large, crop = pictures(0)
    picture = from_pixels(torch.from_numpy(cut_out(large[0], crop))[None])
    session = RenderSession(renderer, picture)
    with torch.no_grad():
        one = renderer.estimator(from_pixels(torch.from_numpy(cut_out(large[2], crop))[None]))
    regions = one.repeat(frames)
    canvases = {size: FullSize(large[0], crop, size) for size in SIZES}
    for size in (256, *SIZES):
        best = np.inf
        for _ in range(3):
            begun = time.perf_counter()
            if size == 256:
                made = sum(len(batch) for batch in session.frames(regions))
            else:
                draw = canvases[size].frames
                made = sum(
                    len(draw(p.flow, p.occlusion, p.painted)) for p in session.parts(regions)
                )
            best = min(best, (time.perf_counter() - begun) / made)
        print(f"{size:5d} {1000 * best:6.1f} ms a frame")


def main() -> None:
    """Print the figures."""
    options = argparse.ArgumentParser()
    options.add_argument("--speaker", type=Path, default=BUNDLE)
    options.add_argument("--presenters", type=int, default=6)
    options.add_argument("--threads", type=int, default=0)
    options.add_argument("--only", choices=("quality", "speed"))
    chosen = options.parse_args()
    if chosen.threads:
        torch.set_num_threads(chosen.threads)
    renderer = Bundle.open(chosen.speaker).renderer().eval()
    if chosen.only != "speed":
        quality(renderer, chosen.presenters)
    if chosen.only != "quality":
        speed(renderer)


if __name__ == "__main__":
    main()
