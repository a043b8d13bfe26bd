"""Pictures of people: are hands and faces still there, where they are in the recorded frames?

Networks that see bodies, hands and faces (`data_prep.speaker.people`) look at the recorded frames,
then at the same places of the made ones. All frames are encoded alike, as a dataset's frames are.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray

from angie.evaluation.definitions import PEOPLE
from angie.evaluation.images import FrameChoice, open_session, pick, read_chosen
from angie.evaluation.space import FrameTruth, Truth
from angie.metrics.score import Score
from angie.motion.clips import MotionClip
from data_prep.dataset import Dataset, encode_frame
from data_prep.rates import IMAGE_SIZE
from data_prep.speaker.people import NOSE, SEEN, TIPS, WRISTS, People, Pose, Square
from mraa.draw import regions_of
from mraa.grid import resize_flow, warp
from mraa.imagenet import EfficientNetLite, installed, load_imagenet
from mraa.renderer import Renderer, from_pixels, to_pixels

BOX = 48
"""Side in pixels of the boxes around hands and face."""

FOLDED = 40
"""Pixels between the middles of the hands below which they are folded."""

TWICE = 2
"""Networks look at frames enlarged so many times: hands of 20 pixels are too small for them."""

FACE_SIDE = 1.43
"""Side of the square that a face's likeness is judged in, in widths of the face."""

FACE_SIZE = 112
"""Pixels of its side."""

FACE_BLOCKS = 5
"""Blocks of the network that knows natural pictures, behind which faces are compared."""

ABOUT = {
    "recorded": "The recorded frames themselves, encoded once more.",
    "first frame": "The first frame of each clip throughout.",
    "warping alone": "The first frame as the flow moves it, nothing painted.",
    "true regions": "Drawn from the regions of the recorded frames: the renderer only.",
}
"""Rows of the table, and where their frames come from."""


@dataclass(frozen=True)
class Seen:
    """What is known of a recorded frame; positions (x, y) in pixels of the frame."""

    centres: NDArray
    """(3, 2) right hand, left hand, face; not finite where unknown."""
    squares: Sequence[Square | None]
    """Of the right and the left hand, where a hand is seen; in pixels of the enlarged frame."""
    body: Square | None
    """Where the body is seen, in pixels of the enlarged frame."""
    face: NDArray | None
    """What the face looks like, see `PeopleJudge.likeness`."""
    wrists: NDArray | None = None
    """(2, 2) true wrists."""
    tips: NDArray | None = None
    """(2, 5, 2) true finger tips."""

    @property
    def folded(self) -> bool:
        """Whether the hands lie in one another, which the hand network can hardly judge."""
        return bool(np.linalg.norm(self.centres[0] - self.centres[1]) < FOLDED)


class PeopleJudge:
    """Looks at frames for people.

    Args:
        folder: of the networks.

    Raises:
        BadInput: a network is missing.
    """

    def __init__(self, folder: Path) -> None:
        self.people = People(folder)

    @cached_property
    def natural(self) -> EfficientNetLite | None:
        """The network that faces are compared by; None where its package is not installed."""
        return load_imagenet(blocks=FACE_BLOCKS) if installed() else None

    def look(
        self, frame: NDArray, pose: Pose | None = None, truth: FrameTruth | None = None
    ) -> Seen:
        """A recorded frame (H, W, 3) uint8.

        Args:
            frame: looked at.
            pose: in pixels of the enlarged frame, if it is known from a better picture.
            truth: of this one frame, in pixels; what is true counts before what is seen.
        """
        large = enlarged(frame)
        pose = pose or self.people.pose(large)
        centres = np.full((3, 2), np.nan)
        squares: list[Square | None] = [None, None]
        if pose is not None:
            hands = [self.people.hand_centre(pose.points, side) for side in (0, 1)]
            centres = (np.stack([*hands, pose.points[NOSE]]) + 0.5) / TWICE - 0.5
            squares = [
                s if s is not None and _inside(s[0] / TWICE, 4) else None
                for s in self.people.hand_squares(pose)
            ]
            squares = [
                s if s is not None and self.people.hand(large, s).score > SEEN else None
                for s in squares
            ]
        wrists = tips = None
        if truth is not None:
            centres, wrists, tips = truth.centres, truth.wrists, truth.tips
        body = None if pose is None else pose.body
        return Seen(centres, squares, body, self.likeness(large), wrists, tips)

    def likeness(self, large: NDArray) -> NDArray | None:
        """What the face of an enlarged frame looks like, a unit vector; None without a face."""
        found = self.people.face(large) if self.natural is not None else None
        if found is None or self.natural is None:
            return None
        x, y, width = found
        scale = FACE_SIZE / (FACE_SIDE * width)
        middle = FACE_SIZE / 2 - scale * np.array([x, y])
        matrix = np.array([[scale, 0, middle[0]], [0, scale, middle[1]]])
        part = cv2.warpAffine(large, matrix, (FACE_SIZE,) * 2, flags=cv2.INTER_AREA)
        with torch.no_grad():
            (features,) = self.natural(from_pixels(torch.from_numpy(part[None])), (FACE_BLOCKS,))
            return F.normalize(features.mean((2, 3))[0], dim=0).numpy()

    def compare(self, made: NDArray, seen: Seen, into: dict[str, list[float]]) -> None:
        """Add the scores of the people in a made frame (H, W, 3) uint8 to those gathered."""
        large = enlarged(made)
        for side, square in enumerate(seen.squares):
            if square is None:
                continue
            hand = self.people.hand(large, square)
            _add(into, "seen_folded" if seen.folded else "seen", 100 * (hand.score > SEEN))
            if seen.tips is not None and not seen.folded:
                points = (hand.points[list(TIPS)] + 0.5) / TWICE - 0.5
                _add(into, "tips", np.linalg.norm(points - seen.tips[side], axis=-1).mean())
        if seen.wrists is not None and seen.body is not None:
            pose = self.people.pose_at(large, seen.body)
            points = (pose.points[list(WRISTS)] + 0.5) / TWICE - 0.5
            for point, wrist in zip(points, seen.wrists, strict=True):
                if _inside(wrist, 4):
                    _add(into, "wrist", np.linalg.norm(point - wrist))
        if seen.face is not None:
            face = self.likeness(large)
            _add(into, "face", 0.0 if face is None else face @ seen.face)


def pixel_errors(
    made: NDArray, true: NDArray, centres: NDArray, into: dict[str, list[float]]
) -> None:
    """Add PSNR and L1 of a frame (H, W, 3) uint8, whole and in boxes, to those gathered.

    Args:
        made: the frame.
        true: the recorded one.
        centres: (3, 2) right hand, left hand, face in it.
        into: values by column.
    """
    gap = (made.astype(np.float32) - true) / 255
    hands, face = [box_around(c) for c in centres[:2]], box_around(centres[2])
    whole = (slice(None), slice(None))
    for name, boxes in (("", [whole]), ("_hands", hands), ("_face", [face])):
        for part in (gap[box] for box in boxes if box is not None):
            _add(into, f"psnr{name}", -10 * np.log10(max((part**2).mean(), 1e-8)))
            _add(into, f"l1{name}", np.abs(part).mean())


def _add(into: dict[str, list[float]], key: str, value: Any) -> None:
    into.setdefault(key, []).append(float(value))


def enlarged(frame: NDArray) -> NDArray:
    """A frame as the networks look at it."""
    return cv2.resize(frame, None, fx=TWICE, fy=TWICE, interpolation=cv2.INTER_CUBIC)


def box_around(centre: NDArray) -> tuple[slice, slice] | None:
    """Rows and columns of the box around a place; None where it is unknown or not in the frame."""
    if not _inside(centre, 4):
        return None
    left, top = (max(0, round(float(v) - BOX / 2)) for v in centre)
    return slice(top, top + BOX), slice(left, left + BOX)


def _inside(place: NDArray, margin: float) -> bool:
    """Whether a place (x, y) is known and lies in the frame."""
    return bool(((place > margin) & (place < IMAGE_SIZE - 1 - margin)).all())


def again(frame: NDArray) -> NDArray:
    """A frame after the encoding that the frames of a dataset have had."""
    coded = np.frombuffer(encode_frame(frame), np.uint8)
    decoded = np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR))
    return np.asarray(cv2.cvtColor(decoded, cv2.COLOR_BGR2RGB))


def scores_of(gathered: Mapping[str, Sequence[float]]) -> dict[str, Score]:
    """The means of what was gathered, for every column."""
    result = {}
    for column in PEOPLE:
        values = gathered.get(column.key, ())
        if len(values):
            result[column.key] = Score(float(np.mean(values)), counts={"of": len(values)})
        else:
            result[column.key] = Score.missing(MISSING.get(column.key, "nothing of this is seen"))
    return result


MISSING = {
    "face": "needs a face, and pip install 'angie[perceptual]'",
    "wrist": "the true wrists are not known (--truth)",
    "tips": "the true finger tips are not known (--truth; the phantom has none)",
}
"""Why a column may have no value."""


def score_people(
    judge: PeopleJudge,
    renderer: Renderer,
    dataset: Dataset,
    clips: Sequence[MotionClip],
    truths: Mapping[str, Truth],
    choice: FrameChoice,
    advance: Callable[..., None],
) -> dict[str, dict[str, Score]]:
    """Reconstruct clips from their first frame, and look at the people in the frames.

    Args:
        judge: the networks.
        renderer: in eval mode.
        dataset: holds the recorded frames.
        clips: test clips.
        truths: of clips, by name, as far as known.
        choice: which frames are looked at.
        advance: called with the number of frames done.

    Returns:
        scores by row (`ABOUT`) and column.
    """
    gathered: dict[str, dict[str, list[float]]] = {name: {} for name in ABOUT}
    stored = {clip.id: clip for clip in dataset.clips()}
    for clip in clips:
        numbers = choice.numbers(clip.motion.frames)
        if not len(numbers):
            continue
        true, source = read_chosen(dataset, stored[clip.name], numbers)
        made = reconstructed(renderer, source, clip, numbers)
        judge.people.forget()
        truth = truths.get(clip.name)
        for i, number in enumerate(numbers):
            seen = judge.look(true[i], truth=None if truth is None else truth.at(int(number)))
            shown = {"recorded": true[i], "first frame": source}
            shown |= {name: frames[i] for name, frames in made.items()}
            for name, frame in shown.items():
                coded = again(frame)
                judge.compare(coded, seen, gathered[name])
                pixel_errors(coded, true[i], seen.centres, gathered[name])
        advance(len(numbers))
    return {name: scores_of(values) for name, values in gathered.items()}


@torch.no_grad()
def reconstructed(
    renderer: Renderer, source: NDArray, clip: MotionClip, numbers: NDArray
) -> dict[str, NDArray]:
    """Frames (n, H, W, 3) uint8 of the rows that the renderer makes of a clip's true regions."""
    session = open_session(renderer, source, clip.motion[:1])
    corners = renderer.config.align_corners
    picture = from_pixels(torch.from_numpy(source[None])).to(session.device)
    warped, drawn = [], []
    for part in session.parts(regions_of(renderer, pick(clip.motion, numbers), session.device)):
        flow = resize_flow(part.flow, *source.shape[:2], align_corners=corners)
        still = picture.expand(len(flow), -1, -1, -1)
        warped.append(to_pixels(warp(still, flow, align_corners=corners)).cpu().numpy())
        drawn.append(part.frames)
    return {"warping alone": np.concatenate(warped), "true regions": np.concatenate(drawn)}
