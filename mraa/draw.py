"""Region motion to frames: poses of pictures, and motion drawn a few frames at a time."""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
import torch

from mraa.affine import encode_cholesky, renderable
from mraa.affine import track_axes as follow
from mraa.fast.fullsize import FullSize
from mraa.fast.session import RenderSession
from mraa.motion import Motion
from mraa.regions import Regions, regions_from_motion
from mraa.renderer import Renderer


def source_pose(renderer: Renderer, picture: torch.Tensor) -> Motion:
    """Pose of a picture (1, 3, H, W) in [0, 1] as motion of one frame, on the CPU."""
    with torch.no_grad():
        regions = renderer.estimator(picture)
    return Motion(regions.shift.cpu(), encode_cholesky(regions.covariance).cpu())


def render(
    renderer: Renderer,
    picture: torch.Tensor,
    pose: Motion,
    motion: Motion,
    precision: str = "auto",
    canvas: FullSize | None = None,
    tracked: bool = False,
) -> Iterator[np.ndarray]:
    """Draw motion a few frames at a time: (b, H, W, 3) uint8 RGB.

    Args:
        renderer: in eval mode.
        picture: (1, 3, H, W) in [0, 1].
        pose: pose of the picture, one frame.
        motion: T frames.
        precision: as `mraa.fast.session.RenderSession`.
        canvas: draws the frames at another size than the picture's.
        tracked: follow the axes of regions from the picture on.
    """
    regions = regions_of(renderer, pose, picture.device)
    driving = regions_of(renderer, motion, picture.device)
    if tracked:
        driving = replace(driving, affine=follow(driving.affine, regions.affine[0]))
    return draw(renderer, picture, regions, driving, precision, canvas)


def draw(
    renderer: Renderer,
    picture: torch.Tensor,
    regions: Regions,
    driving: Regions | Iterable[Regions],
    precision: str = "auto",
    canvas: FullSize | None = None,
) -> Iterator[np.ndarray]:
    """Draw regions a few frames at a time: (b, H, W, 3) uint8 RGB; see `render`.

    Args:
        renderer: in eval mode.
        picture: (1, 3, H, W) in [0, 1].
        regions: (1, K) of the picture.
        driving: (T, K), or any number of such chunks.
        precision: as `mraa.fast.session.RenderSession`.
        canvas: draws the frames at another size than the picture's.
    """
    session = RenderSession(renderer, picture, regions, precision=precision)
    if canvas is None:
        return session.frames(driving)
    return (canvas.frames(p.flow, p.occlusion, p.painted) for p in session.parts(driving))


def regions_of(renderer: Renderer, motion: Motion, device: torch.device) -> Regions:
    """Regions (T, K) of motion, clamped to what can be rendered."""
    covariance = renderable(motion.covariance().to(device))
    return regions_from_motion(motion.shift.to(device), covariance, renderer.config.affine_mode)
