"""Codes of the motion codebooks made visible, on photos (the paper's Figure 4).

A row of the sheet is one pair of codes on every photo, a column one photo with different codes:
the same code moves different people alike. Below, how much each code is used.
"""

from dataclasses import dataclass
from pathlib import Path

import cv2
import imageio.v3 as iio
import numpy as np
import torch
from numpy.typing import NDArray

from angie.bundle import Bundle
from angie.generators.angie.family import NAME, load_generator
from angie.generators.angie.generate import AngieGenerator
from angie.generators.angie.tokenizer import VQMotionExtractor
from angie.source import photo_crop
from angie.video import COMMENT
from data_prep.errors import BadInput
from data_prep.files import check_apart, check_output, whole_file
from data_prep.media.photo import read_photo
from data_prep.media.video import VideoWriter
from data_prep.progress import progress
from data_prep.rates import FRAMES_PER_TOKEN, IMAGE_SIZE
from data_prep.speaker.crop import cut_out
from mraa.draw import render, source_pose
from mraa.motion import Motion
from mraa.renderer import Renderer, from_pixels

REPEATS = 2
"""Times that a code stands in a row in what is shown."""

STILL_AROUND = 5
"""Still codes before and after it, so that it begins and ends in rest."""

LEAST_MOVEMENT = 0.25
"""Pairs that move less than this part of the median pair are left out of the choice."""

STRIP = 120
"""Height in pixels of a histogram."""

CAPTION = 400
"""Width in pixels of the line above a histogram, and so the least width of a picture."""

LABEL = 22
"""Height in pixels of the line above a row."""


@dataclass(frozen=True)
class CodePair:
    """A shift code with a Cholesky code.

    Attributes:
        codes: (2,) int64.
        count: times it stands in the training set; 0 if the bundle does not say.
    """

    codes: torch.Tensor
    count: int

    def __str__(self) -> str:
        """Both codes and the count."""
        shift, cholesky = self.codes.tolist()
        count = f", {self.count} times" if self.count else ""
        return f"shift {shift}, Cholesky {cholesky}{count}"


@dataclass(frozen=True)
class Sheet:
    """What `code_sheet` made.

    Attributes:
        picture: the PNG.
        video: the mp4.
        pairs: what its rows show.
    """

    picture: Path
    video: Path
    pairs: list[CodePair]


def pair_motion(generator: AngieGenerator, codes: torch.Tensor, start: Motion) -> Motion:
    """Motion (16 frames) of a pair of codes that stands twice among still ones.

    Args:
        generator: with codes.
        codes: (2,) int64.
        start: pose of frame 1, one frame.
    """
    assert isinstance(generator.vq, VQMotionExtractor)
    still = generator.vq.start_codes()[:, None]
    around = still.repeat(1, STILL_AROUND)
    row = torch.cat([around, codes[:, None].repeat(1, REPEATS), around], dim=1)
    first, frames = STILL_AROUND * FRAMES_PER_TOKEN, REPEATS * FRAMES_PER_TOKEN
    delta = generator.vq.decode(row[None])[0, first - 1 : first + frames]
    pattern = generator.channels.integrate(delta, start.vector()[0])
    return generator.renderable(pattern, start.vector()[0])[1:]


def choose_pairs(generator: AngieGenerator, report: list[list[int]], count: int) -> list[CodePair]:
    """The most frequent pairs of codes that move, each with another shift code.

    Args:
        generator: with codes.
        report: (shift, Cholesky, count) of the frequent pairs; without any, the most used
            shift codes are taken, with the still Cholesky code.
        count: pairs wanted.
    """
    vq = generator.vq
    assert isinstance(vq, VQMotionExtractor)
    pairs = [CodePair(torch.tensor(entry[:2]), entry[2]) for entry in report]
    if not pairs:
        order = vq.shift.codebook.usage.argsort(descending=True, stable=True)[: 4 * count]
        still = vq.start_codes()[1]
        pairs = [CodePair(torch.stack([code, still]), 0) for code in order]
    rest = Motion.from_vector(generator.statistics.rest[:1])
    moved = []
    for pair in pairs:
        motion = pair_motion(generator, pair.codes, rest)
        moved.append(float((motion.shift - rest.shift).norm(dim=-1).mean()))
    least = LEAST_MOVEMENT * float(np.median(moved))
    chosen: list[CodePair] = []
    for pair, amount in zip(pairs, moved, strict=True):
        if amount >= least and pair.codes[0] not in [one.codes[0] for one in chosen]:
            chosen.append(pair)
    return chosen[:count]


def code_sheet(
    bundle: Bundle,
    photos: list[Path],
    output: Path,
    *,
    count: int = 6,
    person: str | None = None,
    force: bool = False,
) -> Sheet:
    """Draw codes on photos: a PNG, and an mp4 of the same name in which they move.

    Raises:
        BadInput: an input that cannot be used; nothing is left behind.
    """
    video = output.with_suffix(".mp4")
    if output.suffix.lower() != ".png":
        raise BadInput(f"{output}: must end in .png; the video gets the same name")
    check_apart(output, photos)
    for path in (output, video):
        check_output(path, force=force)
        if path.is_dir():
            raise BadInput(f"{path}: is a folder; name another file")
    if bundle.preset.points or not bundle.settings(NAME).has_codes:
        raise BadInput(f"{bundle.folder}: a sheet needs regions and codes")
    renderer, generator = bundle.renderer(), load_generator(bundle)
    report = bundle.report(f"{NAME}.vq").get("pairs", [])
    pairs = choose_pairs(generator, report, count)
    squares = [square_of(path, person) for path in photos]
    frames, ends = _draw(renderer, generator, squares, pairs)
    grid = np.concatenate([_row(str(p), cells) for p, cells in zip(pairs, ends, strict=True)])
    missing = max(CAPTION - grid.shape[1], 0)
    grid = np.pad(grid, ((0, 0), (0, missing), (0, 0)), constant_values=255)
    strips = [_histogram(generator.vq, name, grid.shape[1]) for name in ("shift", "cholesky")]
    with whole_file(output, force=force) as picture, whole_file(video, force=force) as film:
        iio.imwrite(picture, np.concatenate([grid, *strips]), extension=".png")
        _write_film(film, frames, pairs)
    return Sheet(output, video, pairs)


def square_of(path: Path, person: str | None) -> NDArray[np.uint8]:
    """The square (256, 256, 3) uint8 of a photo that is animated."""
    photo = read_photo(path)
    return cut_out(photo, photo_crop(path, photo, person, with_crop=False), IMAGE_SIZE)


def _draw(
    renderer: Renderer,
    generator: AngieGenerator,
    squares: list[NDArray[np.uint8]],
    pairs: list[CodePair],
) -> tuple[list[list[NDArray[np.uint8]]], list[list[NDArray[np.uint8]]]]:
    """Frames (T, H, W, 3) of every pair on every photo, and the last ones with arrows."""
    frames: list[list[NDArray[np.uint8]]] = [[] for _ in pairs]
    ends: list[list[NDArray[np.uint8]]] = [[] for _ in pairs]
    with progress("codes", len(pairs) * len(squares), "cells") as advance:
        for square in squares:
            picture = from_pixels(torch.from_numpy(square)[None])
            pose = source_pose(renderer, picture)
            for row, pair in enumerate(pairs):
                motion = pair_motion(generator, pair.codes, pose)
                drawn = np.concatenate(list(render(renderer, picture, pose, motion)))
                frames[row].append(drawn)
                ends[row].append(_arrows(drawn[-1], pose, motion))
                advance(1)
    return frames, ends


def _arrows(image: NDArray[np.uint8], pose: Motion, motion: Motion) -> NDArray[np.uint8]:
    """The image with an arrow from where each region was to where it is."""
    drawn = image.copy()
    scale = (IMAGE_SIZE - 1) / 2
    for begin, end in zip(pose.shift[0], motion.shift[-1], strict=True):
        if float((end - begin).norm()) > 0.01:
            tail, head = (
                tuple(int(round(float(v + 1) * scale)) for v in point) for point in (begin, end)
            )
            cv2.arrowedLine(drawn, tail, head, (255, 220, 0), 2, cv2.LINE_AA, tipLength=0.3)
    return drawn


def _row(text: str, cells: list[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Cells side by side under a line of text."""
    images = np.concatenate(cells, axis=1)
    line = np.full((LABEL, images.shape[1], 3), 255, np.uint8)
    return np.concatenate([_written(line, text), images])


def _written(image: NDArray[np.uint8], text: str) -> NDArray[np.uint8]:
    """The image with a line of text at its top."""
    font, black = cv2.FONT_HERSHEY_SIMPLEX, (0, 0, 0)
    return cv2.putText(image, text, (4, LABEL - 7), font, 0.42, black, 1, cv2.LINE_AA)  # type: ignore[return-value]


def _histogram(vq: object, name: str, width: int) -> NDArray[np.uint8]:
    """How often each code of a stream was used lately in training, the most used first."""
    assert isinstance(vq, VQMotionExtractor)
    book = getattr(vq, name).codebook
    usage = book.usage.sort(descending=True).values.numpy()
    strip = np.full((STRIP, width, 3), 255, np.uint8)
    heights = (usage / max(usage.max(), 1e-12) * (STRIP - LABEL - 4)).round().astype(int)
    edges = np.linspace(0, width, len(usage) + 1).round().astype(int)
    for left, right, height in zip(edges[:-1], edges[1:], heights, strict=True):
        strip[STRIP - height :, left : max(right, left + 1)] = (60, 110, 190)
    text = (
        f"{name}: {int(book.used())} of {len(usage)} codes used, "
        f"perplexity {float(book.perplexity()):.0f}"
    )
    return _written(strip, text)


def _write_film(path: Path, frames: list[list[NDArray[np.uint8]]], pairs: list[CodePair]) -> None:
    """All cells at once: there, a moment's rest, and back; twice."""
    last = len(frames[0][0]) - 1
    there = list(range(last + 1))
    order = 2 * [*[0] * 6, *there, *[last] * 6, *reversed(there)]
    shape = (
        sum(len(_row("", [cells[0][0]])) for cells in frames),
        sum(c.shape[2] for c in frames[0]),
    )
    with VideoWriter(path, (shape[1], shape[0]), comment=COMMENT) as video:
        for place in order:
            rows = [
                _row(str(pair), [cell[place] for cell in cells])
                for pair, cells in zip(pairs, frames, strict=True)
            ]
            video.write(np.concatenate(rows))
