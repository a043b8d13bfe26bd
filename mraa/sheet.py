"""Sheets to look at: source, driving with regions, deformed source, occlusion, prediction."""

import colorsys
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor

from mraa.flow import deform
from mraa.regions import Regions
from mraa.renderer import Renderer, to_pixels


def draw_regions(image: np.ndarray, regions: Regions) -> np.ndarray:
    """Draw each region as an ellipse of one standard deviation.

    Args:
        image: (H, W, 3) uint8 RGB.
        regions: of one image, (1, K).

    Returns:
        A copy of the image with the ellipses.
    """
    drawn = image.copy()
    height, width = image.shape[:2]
    count = regions.shift.shape[1]
    scale = np.array([(width - 1) / 2, (height - 1) / 2])
    for k in range(count):
        centre = (regions.shift[0, k].cpu().numpy() + 1) * scale
        axes = regions.affine[0, k].cpu().numpy() * scale[:, None]  # columns, in pixels
        angles = np.linspace(0, 2 * np.pi, 24)
        outline = centre + np.stack([np.cos(angles), np.sin(angles)], axis=1) @ axes.T
        colour = [int(255 * c) for c in colorsys.hsv_to_rgb(k / count, 0.9, 1.0)]
        points = np.round(outline * 8).astype(np.int32)
        cv2.polylines(drawn, [points], True, colour, 1, cv2.LINE_AA, shift=3)
        dot = tuple(int(v) for v in np.round(centre * 8))
        cv2.circle(drawn, dot, 16, colour, -1, cv2.LINE_AA, shift=3)
    return drawn


@torch.no_grad()
def sample_sheet(renderer: Renderer, source: Tensor, driving: Tensor, rows: int = 4) -> np.ndarray:
    """One row a pair: source, driving, regions, deformed source, occlusion, prediction.

    Args:
        renderer: put into eval mode for the sheet and back.
        source: (B, 3, H, W) in [0, 1].
        driving: (B, 3, H, W) in [0, 1].
        rows: pairs shown at most.

    Returns:
        (rows * H, 6 * W, 3) uint8 RGB.
    """
    mode = renderer.training
    renderer.eval()
    source, driving = source[:rows], driving[:rows]
    source_regions, driving_regions = renderer.estimator(source), renderer.estimator(driving)
    background = renderer.background(source, driving)
    prediction, flow = renderer(source, source_regions, driving_regions, background)
    corners = renderer.config.align_corners
    height, width = source.shape[2:]
    moved = deform(source, flow, align_corners=corners)
    occlusion = torch.nn.functional.interpolate(flow.occlusion, size=(height, width))
    renderer.train(mode)
    columns = [
        to_pixels(x.float()).cpu().numpy()
        for x in (source, driving, moved, occlusion.expand(-1, 3, -1, -1), prediction)
    ]
    marked = np.stack(
        [draw_regions(columns[1][i], driving_regions[i : i + 1]) for i in range(len(source))]
    )
    ordered = [*columns[:2], marked, *columns[2:]]
    return np.concatenate([np.concatenate(list(c)) for c in ordered], axis=1)


def write_sheet(path: Path, sheet: np.ndarray) -> None:
    """Write a sheet (H, W, 3) uint8 RGB as PNG, making its folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    # OpenCV itself does not write to every name on every system
    path.write_bytes(cv2.imencode(".png", cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR))[1].tobytes())
