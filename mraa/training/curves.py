"""Learning curves of a stage and sheets of sample pictures.

Curves are a table (CSV), a picture (PNG) and, where TensorBoard is installed, its events.
"""

import colorsys
import csv
from importlib.util import find_spec
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
    from skimage.util import montage  # for training only

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
    tiles = np.stack(ordered, axis=1).reshape(-1, height, width, 3)
    return montage(tiles, grid_shape=(len(source), len(ordered)), channel_axis=-1)


def write_sheet(path: Path, sheet: np.ndarray) -> None:
    """Write a sheet (H, W, 3) uint8 RGB as PNG, making its folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    import imageio.v3 as iio

    iio.imwrite(path, sheet, extension=".png")


Points = dict[str, list[tuple[int, float]]]
"""(step, value) of every curve."""


class Curves:
    """Curves of a stage in `folder`: `<stage>.csv`, `<stage>.png`, `<stage>/` for TensorBoard.

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
        self._events: Any = None
        if find_spec("tensorboard"):
            from torch.utils.tensorboard import SummaryWriter

            self._events = SummaryWriter(str(self.folder / stage), purge_step=first)

    @property
    def table(self) -> Path:
        """CSV of step, name, value."""
        return self.folder / f"{self.stage}.csv"

    def add(self, step: int, values: dict[str, float]) -> None:
        """Add a point to several curves."""
        for name, value in values.items():
            self._points.setdefault(name, []).append((step, value))
            if self._events is not None:
                self._events.add_scalar(name, value, step)

    def image(self, name: str, picture: np.ndarray, step: int) -> None:
        """Show a picture (H, W, 3) uint8 RGB in TensorBoard, where that is installed."""
        if self._events is not None:
            self._events.add_image(name, picture, step, dataformats="HWC")

    def write(self) -> None:
        """Bring the files up to date."""
        if self._events is not None:
            self._events.flush()
        self.folder.mkdir(parents=True, exist_ok=True)
        with whole_file(self.table, force=True) as part:
            with part.open("w", newline="") as file:
                rows = csv.writer(file)
                rows.writerow(("step", "name", "value"))
                for name, points in self._points.items():
                    rows.writerows((step, name, repr(value)) for step, value in points)
        with whole_file(self.folder / f"{self.stage}.png", force=True) as part:
            draw_curves(self._points, part)

    def close(self) -> None:
        """Write what is left; the files stay."""
        if self._events is not None:
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


def draw_curves(points: Points, path: Path) -> None:
    """Draw a panel for every curve, two in a row: points in grey, their running mean in blue.

    The axis is logarithmic where all values are positive and the largest is over 20 times the
    smallest. Points that are not finite are left out.
    """
    from matplotlib.figure import Figure  # takes a second

    rows = max(1, -(-len(points) // 2))
    figure = Figure(figsize=(9.6, 2.4 * rows), layout="constrained")
    for place, (name, curve) in enumerate(points.items(), 1):
        axes = figure.add_subplot(rows, 2, place)
        steps, values = np.array(curve, dtype=np.float64).reshape(-1, 2).T
        steps, values = steps[np.isfinite(values)], values[np.isfinite(values)]
        last = f", last {values[-1]:.4g}" if len(values) else ""
        axes.set_title(f"{name}{last}", fontsize=9)
        if not len(values):
            continue
        logarithmic = values.min() > 0 and values.max() > 20 * values.min()
        axes.set_yscale("log" if logarithmic else "linear")
        axes.plot(steps, values, color="0.75", linewidth=0.8)
        smooth = np.exp(_smooth(np.log(values))) if logarithmic else _smooth(values)
        axes.plot(steps, smooth, color="tab:blue", linewidth=1.2)
    figure.savefig(path, dpi=100)


def _smooth(line: np.ndarray) -> np.ndarray:
    """Mean over a twentieth of the points on either side."""
    from scipy.ndimage import uniform_filter1d

    reach = len(line) // 20
    return uniform_filter1d(line, 2 * reach + 1, mode="nearest")
