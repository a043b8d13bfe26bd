"""Learning curves of a stage: TensorBoard events, a table (CSV) and a picture (PNG).

Sheets to look at: source, driving with regions, deformed source, occlusion, prediction.
"""

import colorsys
import csv
import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from torch import Tensor

from data_prep.errors import BadInput
from data_prep.files import whole_file
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


Points = dict[str, list[tuple[int, float]]]
"""(step, value) of every curve."""


PANEL = (480, 240)
"""Width and height of a curve's panel in pixels."""


class Curves:
    """Curves of a stage in `folder`: `<stage>/` for TensorBoard, `<stage>.csv`, `<stage>.png`.

    Args:
        folder: is made if need be.
        stage: name of the files.
        first: step to go on from; older points are read from the table, later ones dropped.

    Raises:
        BadInput: the table is damaged.
    """

    def __init__(self, folder: Path, stage: str, first: int) -> None:
        self.folder, self.stage = Path(folder), stage
        self._points: Points = _read(self.table, first) if first else {}
        from torch.utils.tensorboard import SummaryWriter

        self._events: Any = SummaryWriter(str(self.folder / stage), purge_step=first)

    @property
    def table(self) -> Path:
        """CSV of step, name, value."""
        return self.folder / f"{self.stage}.csv"

    def add(self, step: int, values: dict[str, float]) -> None:
        """Add a point to several curves."""
        for name, value in values.items():
            self._points.setdefault(name, []).append((step, value))
            self._events.add_scalar(name, value, step)

    def image(self, name: str, picture: np.ndarray, step: int) -> None:
        """Show a picture (H, W, 3) uint8 RGB in TensorBoard."""
        self._events.add_image(name, picture, step, dataformats="HWC")

    def write(self) -> None:
        """Bring the files up to date."""
        self._events.flush()
        with whole_file(self.table, force=True) as part:
            with part.open("w", newline="") as file:
                rows = csv.writer(file)
                rows.writerow(("step", "name", "value"))
                for name, points in self._points.items():
                    rows.writerows((step, name, repr(value)) for step, value in points)
        write_sheet(self.folder / f"{self.stage}.png", draw_curves(self._points))

    def close(self) -> None:
        """Write what is left; the files stay."""
        self._events.close()


def _read(table: Path, first: int) -> Points:
    """Points before step `first` of a table that `Curves` wrote; none where there is none."""
    points: Points = {}
    if not table.exists():
        return points
    try:
        with table.open(newline="") as file:
            for row in csv.DictReader(file):
                if int(row["step"]) < first:
                    points.setdefault(row["name"], []).append(
                        (int(row["step"]), float(row["value"]))
                    )
    except (ValueError, KeyError, TypeError, csv.Error) as error:
        raise BadInput(f"{table}: damaged; delete it to go on without its curves") from error
    return points


def draw_curves(points: Points) -> np.ndarray:
    """A panel for every curve, two in a row: points in grey, their running mean in blue.

    The axis is logarithmic where all values are positive and the largest is over 20 times the
    smallest. Points that are no finite numbers are left out.

    Returns:
        (H, W, 3) uint8 RGB.
    """
    panels = [_panel(name, curve) for name, curve in points.items()]
    blank = np.full((PANEL[1], PANEL[0], 3), 255, np.uint8)
    panels += [blank] * (-len(panels) % 2 or 2 * (not panels))
    rows = [np.hstack(panels[i : i + 2]) for i in range(0, len(panels), 2)]
    return np.vstack(rows)


def _panel(name: str, curve: list[tuple[int, float]]) -> np.ndarray:
    width, height = PANEL
    left, right, top, bottom = 70, width - 15, 30, height - 25
    panel = np.full((height, width, 3), 255, np.uint8)
    _write(panel, name, (left, 20), 0.5)
    cv2.rectangle(panel, (left, top), (right, bottom), (200, 200, 200), 1)
    finite = [(step, value) for step, value in curve if math.isfinite(value)]
    if not finite:
        return panel
    steps, values = (np.array(column, dtype=np.float64) for column in zip(*finite, strict=True))
    logarithmic = values.min() > 0 and values.max() > 20 * values.min()
    heights = np.log(values) if logarithmic else values
    low, high = float(heights.min()), float(heights.max())

    def place(line: np.ndarray) -> np.ndarray:
        x = left + (right - left) * (steps - steps[0]) / max(1.0, steps[-1] - steps[0])
        y = bottom - (bottom - top) * (line - low) / max(high - low, 1e-12)
        return np.round(16 * np.stack([x, y], axis=1)).astype(np.int32)  # in 16ths of a pixel

    for line, colour in ((heights, (190, 190, 190)), (_smooth(heights), (30, 80, 200))):
        cv2.polylines(panel, [place(line)], False, colour, 1, cv2.LINE_AA, shift=4)
    for value, y in ((values.max(), top + 10), (values.min(), bottom)):
        _write(panel, f"{value:.4g}", (5, y), 0.4)
    _write(panel, f"{int(steps[0])}", (left, height - 8), 0.4)
    _write(panel, f"{int(steps[-1])}", (right - 50, height - 8), 0.4)
    _write(panel, f"last {values[-1]:.4g}{', log' if logarithmic else ''}", (right - 150, 20), 0.4)
    return panel


def _smooth(line: np.ndarray) -> np.ndarray:
    """Mean over a twentieth of the points on either side."""
    reach = len(line) // 20
    total = np.concatenate([[0.0], np.cumsum(line)])
    low = np.maximum(np.arange(len(line)) - reach, 0)
    high = np.minimum(np.arange(len(line)) + reach + 1, len(line))
    return (total[high] - total[low]) / (high - low)


def _write(panel: np.ndarray, text: str, at: tuple[int, int], size: float) -> None:
    cv2.putText(panel, text, at, cv2.FONT_HERSHEY_SIMPLEX, size, (60, 60, 60), 1, cv2.LINE_AA)
