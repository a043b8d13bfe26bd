"""The render session: one photo opened, motion in, frames out, as fast as the device can."""

import copy
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
import torch
from torch import Tensor

from mraa.fast import enabled
from mraa.fast.gpu import Accelerated
from mraa.regions import Regions
from mraa.renderer import Parts, Renderer
from mraa.training.devices import choose_precision

BATCH = {"cpu": 4, "gpu": 16}
"""Frames drawn together."""


Motion = Regions | Iterable[Regions]


Pose = tuple[Regions, Tensor]
"""Regions (t, K) and homographies (t, 3, 3) of the background."""


class RenderSession:
    """One photo, animated.

    Frames are drawn in batches of `batch`, each by a thread of its own; a batch that the motion
    does not fill is drawn in full. So a frame does not depend on how the motion is cut into
    chunks, nor on the number of threads. The renderer given is not changed.

    Args:
        renderer: in eval or training mode; its weights are copied.
        photo: (1, 3, H, W) float32 in [0, 1].
        regions: (1, K) of the photo, when known already.
        precision: "auto", "fp32", "bf16" or "fp16": of the convolutions; coordinates, masks and
            warps are always float32. "auto" is the fastest that the device has natively.
        batch: frames drawn together; 0 for `BATCH` of the device.
        workers: threads that draw on a CPU; 0 for as many as torch uses. Without kernels, and on a
            GPU, there is one.
        kernels: whether a CPU uses compiled kernels; None for what `mraa.fast.enabled` says.

    Raises:
        ValueError: a photo that is not one picture, or a precision that the device has not.
    """

    @torch.no_grad()
    def __init__(
        self,
        renderer: Renderer,
        photo: Tensor,
        regions: Regions | None = None,
        *,
        precision: str = "auto",
        batch: int = 0,
        workers: int = 0,
        kernels: bool | None = None,
    ) -> None:
        if photo.ndim != 4 or len(photo) != 1 or photo.shape[1] != 3:
            raise ValueError(f"a photo is (1, 3, H, W), not {tuple(photo.shape)}")
        self.device = photo.device
        self.dtype = choose_precision(precision, self.device)
        on_cpu = self.device.type == "cpu"
        self.batch = batch or BATCH["cpu" if on_cpu else "gpu"]
        self.folded = on_cpu and (enabled() if kernels is None else kernels)
        self.workers = (workers or torch.get_num_threads()) if self.folded else 1
        if any(module.training for module in renderer.modules()):
            renderer = copy.deepcopy(renderer).eval()
        source = renderer.open(photo.float(), regions)
        self.regions = source.regions
        self.draw: Callable[[Regions, Tensor, bool], Parts]
        if self.folded:
            from mraa.fast.generator import Folded  # compiles

            self.draw = Folded(renderer, source, self.batch, self.dtype)
        else:
            self.draw = Accelerated(renderer, source, self.batch, self.dtype)

    def frames(
        self, motion: Motion, background: Tensor | Iterable[Tensor] | None = None
    ) -> Iterator[np.ndarray]:
        """Draw motion.

        Args:
            motion: regions (T, K) with their affine, or any number of such chunks.
            background: (T, 3, 3) homographies of the background, or a chunk of them for every
                chunk of the motion; None when the camera stands still.

        Yields:
            (b, H, W, 3) uint8 RGB, b at most `batch`, T frames in all.
        """
        for part in self._draw(motion, background, painted=False):
            yield part.frames

    def parts(
        self, motion: Motion, background: Tensor | Iterable[Tensor] | None = None
    ) -> Iterator[Parts]:
        """Draw motion as `frames` does, with flow, occlusion and generated picture."""
        return self._draw(motion, background, painted=True)

    def _draw(
        self, motion: Motion, background: Tensor | Iterable[Tensor] | None, *, painted: bool
    ) -> Iterator[Parts]:
        poses = _batches(_poses(motion, background), self.batch)
        threads = torch.get_num_threads()
        running: deque[Future[Parts]] = deque()
        try:
            alone = _one_thread if self.folded else None
            with ThreadPoolExecutor(self.workers, initializer=alone) as pool:
                for pose in poses:
                    running.append(pool.submit(self._batch, *pose, painted))
                    if len(running) > self.workers:
                        yield running.popleft().result()
                while running:
                    yield running.popleft().result()
        finally:  # also where nobody wants the rest
            torch.set_num_threads(threads)  # what one thread sets is what new ones begin with

    def _batch(self, driving: Regions, background: Tensor, painted: bool) -> Parts:
        """Draw up to `batch` frames."""
        count = len(driving.shift)
        parts = self.draw(_filled(driving, self.batch), _fill(background, self.batch), painted)
        return Parts(
            parts.flow[:count], parts.occlusion[:count], parts.painted[:count], parts.frames[:count]
        )


def _one_thread() -> None:
    """Frames are drawn side by side, each by one thread."""
    torch.set_num_threads(1)


def _fill(x: Tensor, count: int) -> Tensor:
    """Repeat the last row up to `count` rows."""
    return torch.cat([x, x[-1:].expand(count - len(x), *x.shape[1:])]) if len(x) < count else x


def _filled(regions: Regions, count: int) -> Regions:
    return Regions(*(_fill(x, count) for x in (regions.shift, regions.covariance, regions.affine)))


def _poses(motion: Motion, background: Tensor | Iterable[Tensor] | None) -> Iterator[Pose]:
    """Chunks of regions (t, K) and homographies (t, 3, 3)."""
    chunks = [motion] if isinstance(motion, Regions) else motion
    if background is None:
        for chunk in chunks:
            yield chunk, torch.eye(3).expand(len(chunk.shift), 3, 3)
        return
    moves = [background] if isinstance(background, Tensor) else background
    yield from zip(chunks, moves, strict=True)


def _batches(poses: Iterable[Pose], size: int) -> Iterator[Pose]:
    """The same frames in chunks of `size`, the last one as long as it comes."""
    held: list[Pose] = []
    count = 0
    for regions, background in poses:
        first = 0
        length = len(regions.shift)
        while first < length:
            last = min(length, first + size - count)
            held.append((regions[first:last], background[first:last]))
            count, first = count + last - first, last
            if count == size:
                yield _joined(held)
                held, count = [], 0
    if held:
        yield _joined(held)


def _joined(poses: list[Pose]) -> Pose:
    regions = [pose[0] for pose in poses]
    return (
        Regions(
            torch.cat([r.shift for r in regions]),
            torch.cat([r.covariance for r in regions]),
            torch.cat([r.affine for r in regions]),
        ),
        torch.cat([pose[1] for pose in poses]),
    )
