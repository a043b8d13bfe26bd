"""Image scores: rendered frames against the recorded ones, from the first frame of each clip."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from angie.evaluation.definitions import IMAGES, PIXEL
from angie.evaluation.rows import TRUE_REGIONS
from angie.evaluation.space import JointReader
from angie.metrics import images
from angie.metrics.images import IdentityNetwork, embed
from angie.metrics.score import Score
from angie.motion.clips import MotionClip
from data_prep.dataset import Clip, Dataset
from data_prep.rates import FPS
from mraa.draw import regions_of, render
from mraa.extract import measure_motion
from mraa.fast.session import RenderSession
from mraa.motion import Motion
from mraa.perceptual import ImageScores, PerceptualDistance
from mraa.perceptual import score as image_scores
from mraa.renderer import Renderer, from_pixels

FROM_SOUND = ", from sound"
"""After the name of a row whose pictures are of generated motion."""

AT_ONCE = 8
"""Frames scored together."""

DRAWN = {"l1_drawn": "l1", "perceptual_drawn": "perceptual"}
"""Scores against frames that are drawn from the true regions, and of which kind each is."""

SCORED_IN = "fp32"
"""Precision of the frames that are scored."""

Driver = Callable[[MotionClip], Motion]
"""Gives the motion that is rendered for a clip."""


@dataclass(frozen=True)
class FrameJudge:
    """Networks that look at frames.

    Attributes:
        renderer: whose region estimator is used, in eval mode.
        perceptual: network of the perceptual distance.
        identity: network of AED; None where the training set has one clip only.
        reader: reads the phantom's joints; None where their truth is not known.
    """

    renderer: Renderer
    perceptual: PerceptualDistance
    identity: IdentityNetwork | None
    reader: JointReader | None


@dataclass
class FrameScores:
    """What is gathered over frames; one entry of each list a clip."""

    pixels: dict[str, list[NDArray]] = field(default_factory=dict)
    drawn: dict[str, list[NDArray]] = field(default_factory=dict)
    embeddings: tuple[list[NDArray], list[NDArray]] = field(default_factory=lambda: ([], []))
    detected: tuple[list[NDArray], list[NDArray]] = field(default_factory=lambda: ([], []))
    shifts: tuple[list[NDArray], list[NDArray]] = field(default_factory=lambda: ([], []))
    joints: tuple[list[NDArray], list[NDArray]] = field(default_factory=lambda: ([], []))
    flicker: list[float] = field(default_factory=list)
    without_embeddings: str = "the training set has too few clips to learn identities from"

    def scores(self) -> dict[str, Score]:
        """All scores of `definitions.IMAGES`."""
        if not self.pixels:
            reason = "no frame has a recorded counterpart"
            return {definition.key: Score.missing(reason) for definition in IMAGES}
        result = {key: _mean_over_frames(parts) for key, parts in self.pixels.items()}
        drawn = Score.missing("what another system would draw of true regions is not known")
        for key in DRAWN:
            result[key] = _mean_over_frames(self.drawn[key]) if self.drawn else drawn
        points = self.detected if self.detected[0] else self.joints
        unknown = "the true joints are not known (phantom speaker: --truth)"
        detector = "needs key points of a detector (--videos with --detected)"
        pairs = {"pairs of frames": len(self.flicker)}
        return result | {
            "aed": _if_any(images.aed, self.embeddings, self.without_embeddings),
            "akd": images.akd(*self.shifts),
            "akd_joints": _if_any(images.akd, points, unknown),
            "mkr": _if_any(images.mkr, self.detected, detector),
            "flicker": Score(float(np.mean(self.flicker)), counts=pairs)
            if self.flicker
            else Score.missing("no two frames in a row", **pairs),
        }


def _if_any(
    metric: Callable[[list[NDArray], list[NDArray]], Score],
    sides: tuple[list[NDArray], list[NDArray]],
    reason: str,
) -> Score:
    return metric(*sides) if sides[0] else Score.missing(reason)


def _mean_over_frames(parts: list[NDArray]) -> Score:
    values = np.concatenate(parts)
    return Score(float(values.mean()), counts={"frames": len(values)})


@dataclass(frozen=True)
class FrameChoice:
    """Which frames of a clip are scored.

    Attributes:
        stride: every so many frames two in a row are.
        seconds: of the beginning of each clip; 0 for all of it.
    """

    stride: int
    seconds: float = 0.0

    def numbers(self, count: int) -> NDArray:
        """Numbers of the frames scored of a clip of `count` frames."""
        within = min(count, round(self.seconds * FPS)) if self.seconds else count
        return chosen_frames(within, self.stride)

    def __str__(self) -> str:
        """A sentence for the report."""
        within = f" in the first {self.seconds:g} s of each clip" if self.seconds else ""
        return f"Every {self.stride}th frame and the one after it{within}"


def chosen_frames(count: int, stride: int) -> NDArray:
    """Numbers of the frames that are scored: every `stride`-th and the one after it.

    The first frame is the source and never scored; a pair in a row is what flicker needs. A clip
    that is too short for the stride gives its last two.
    """
    first = np.arange(max(stride, 1), count - 1, max(stride, 2))
    if not len(first) and count > 2:
        first = np.array([count - 2])
    return np.stack([first, first + 1], axis=1).reshape(-1)


@torch.no_grad()
def compare(
    judge: FrameJudge,
    gathered: FrameScores,
    true: NDArray,
    made: NDArray,
    seen: Motion,
    joints: NDArray | None,
    drawn: NDArray | None = None,
) -> None:
    """Score generated frames of one clip and add the scores to those gathered.

    Args:
        judge: the networks.
        gathered: added to.
        true: (n, H, W, 3) uint8 recorded frames: pairs in a row, as `chosen_frames`.
        made: of the same shape.
        seen: regions of the true frames, n.
        joints: (n, J, 2) true joints in pixels; None when unknown.
        drawn: as `true`, what the renderer draws from the true regions; None for frames of
            another system.
    """
    for batch in _pixel_scores(judge, made, true):
        for key in ("l1", "perceptual", "ssim", "psnr"):
            gathered.pixels.setdefault(key, []).append(_numbers(getattr(batch, key)))
    for batch in () if drawn is None else _pixel_scores(judge, made, drawn):
        for key, kind in DRAWN.items():
            gathered.drawn.setdefault(key, []).append(_numbers(getattr(batch, kind)))
    if judge.identity is not None:
        for side, frames in zip(gathered.embeddings, (true, made), strict=True):
            side.append(embed(judge.identity, frames))
    own = measure_motion(judge.renderer.estimator, made, AT_ONCE)
    for side, motion in zip(gathered.shifts, (seen, own), strict=True):
        side.append(motion.shift.double().numpy() * PIXEL)
    if joints is not None and judge.reader is not None:
        gathered.joints[0].append(joints)
        gathered.joints[1].append(judge.reader(own.vector().double().numpy()))
    pairs = [frames.reshape(-1, 2, *frames.shape[1:]) for frames in (true, made)]
    for a, b in zip(*pairs, strict=True):
        gathered.flicker.append(images.flicker(a / np.float32(255), b / np.float32(255)))


def _pixel_scores(judge: FrameJudge, made: NDArray, true: NDArray) -> Iterator[ImageScores]:
    device = next(judge.renderer.parameters()).device
    for first in range(0, len(made), AT_ONCE):
        pair = [
            from_pixels(torch.from_numpy(frames[first : first + AT_ONCE]).to(device))
            for frames in (made, true)
        ]
        yield image_scores(pair[0], pair[1], judge.perceptual)


def _numbers(values: Tensor) -> NDArray:
    return values.cpu().double().numpy()


def score_pictures(
    judge: FrameJudge,
    dataset: Dataset,
    clips: Sequence[MotionClip],
    drivers: dict[str, Driver],
    joints: dict[str, NDArray],
    choice: FrameChoice,
    advance: Callable[..., None],
) -> dict[str, dict[str, Score]]:
    """Render clips from their first frame with each driver's motion, and score the frames.

    Args:
        judge: the networks.
        dataset: holds the recorded frames.
        clips: test clips.
        drivers: by the name of their row; that of `TRUE_REGIONS` comes before them.
        joints: true joints (T, J, 2) of clips, by name, as far as known.
        choice: which frames are scored.
        advance: called with the number of frames done.

    Returns:
        scores by row and key.
    """
    gathered = {name: FrameScores() for name in (TRUE_REGIONS, *drivers)}
    stored = {clip.id: clip for clip in dataset.clips()}
    for clip in clips:
        numbers = choice.numbers(clip.motion.frames)
        if not len(numbers):
            continue
        true, source = read_chosen(dataset, stored[clip.name], numbers)
        session = open_session(judge.renderer, source, clip.motion[:1])
        seen = pick(clip.motion, numbers)
        known = joints.get(clip.name)
        part = None if known is None else known[numbers]
        drawn: NDArray | None = None
        for name, driver in {TRUE_REGIONS: lambda own: own.motion, **drivers}.items():
            motion = pick(driver(clip), numbers)
            driving = regions_of(judge.renderer, motion, session.device)
            made = np.concatenate(list(session.frames(driving)))
            drawn = made if drawn is None else drawn  # the first ones, of the true regions
            compare(judge, gathered[name], true, made, seen, part, drawn)
            advance(len(numbers))
    return {name: part.scores() for name, part in gathered.items()}


def read_chosen(dataset: Dataset, clip: Clip, numbers: NDArray) -> tuple[NDArray, NDArray]:
    """Frames (n, H, W, 3) uint8 of a clip with these numbers, and its first frame (H, W, 3)."""
    store = dataset.frames(clip)
    return np.stack([store[int(i)] for i in numbers]), store[0]


def pick(motion: Motion, numbers: NDArray) -> Motion:
    """The frames of a motion with these numbers."""
    index = torch.as_tensor(numbers)
    return Motion(motion.shift[index], motion.cholesky[index])


def open_session(renderer: Renderer, source: NDArray, pose: Motion) -> RenderSession:
    """A session that draws what is scored from a frame (H, W, 3) uint8 and its pose."""
    device = next(renderer.parameters()).device
    picture = from_pixels(torch.from_numpy(source)[None]).to(device)
    return RenderSession(renderer, picture, regions_of(renderer, pose, device), precision=SCORED_IN)


def rendered(
    renderer: Renderer, source: NDArray, pose: Motion, motion: Motion
) -> Iterator[NDArray]:
    """Frames (b, H, W, 3) uint8 of a motion, a few at a time, as `angie animate` draws them.

    Args:
        renderer: in eval mode.
        source: (H, W, 3) uint8.
        pose: its pose, one frame.
        motion: T frames.
    """
    device = next(renderer.parameters()).device
    picture = from_pixels(torch.from_numpy(source)[None]).to(device)
    return render(renderer, picture, pose, motion)
