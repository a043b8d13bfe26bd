"""A sheet that shows a video before it is drawn: some frames with regions, and curves over time."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from angie.motion.statistics import BEAT_COLUMN
from angie.video import GestureVideo
from data_prep.errors import BadInput
from data_prep.files import check_apart, whole_file
from data_prep.media.audio import read_sound
from data_prep.rates import FPS, FRAMES_PER_TOKEN, SAMPLES_PER_FRAME
from data_prep.speech.features import Speech, mono
from mraa.draw import render
from mraa.motion import Motion

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from angie.pipeline import GesturePipeline

FRAMES = 6
"""Of a sheet, from the middles of as many equal parts of the video."""

SIGMAS = 1.5
"""Standard deviations of a region that its ellipse shows."""


@dataclass(frozen=True)
class Curves:
    """What a video does over time.

    Attributes:
        level: (T,) root mean square of the sound in each frame; None without sound.
        onsets: (n,) seconds of onsets of the sound.
        beats: (m,) seconds of beats of the sound, to a token's length.
        speed: (T,) how fast the regions that gesture go, in halves of the square's side a second.
        codes: (streams, S) of the motion, one a token; None of a generator without codes.
    """

    level: NDArray | None
    onsets: NDArray
    beats: NDArray
    speed: NDArray
    codes: NDArray | None


def curves(video: GestureVideo, pipeline: "GesturePipeline") -> Curves:
    """Measure a video that was made but need not be drawn.

    Raises:
        BadInput: motion that a driving video gives only as it is read.
    """
    if video.motion is None:
        raise BadInput("--preview goes with gestures to sound and saved motion, not with --drive")
    active = pipeline.statistics.active
    shift = video.motion.shift[:, active]
    steps = (shift[1:] - shift[:-1]).norm(dim=-1).mean(-1).numpy() * FPS
    speed = np.concatenate([[0.0], steps])
    level, onsets, beats = None, np.zeros(0), np.zeros(0)
    if video.sound is not None:
        given = video.sound
        speech = Speech(mono(*given) if isinstance(given, tuple) else read_sound(given))
        level, onsets = _level(speech.samples, len(speed)), speech["onset_times"]
        beats = np.flatnonzero(speech["onset"][:, BEAT_COLUMN] > 0) * FRAMES_PER_TOKEN / FPS
    codes_of = getattr(pipeline.generator, "codes_of", None) if video.speech else None
    codes = None if codes_of is None else codes_of(video.motion)
    return Curves(level, onsets, beats, speed, None if codes is None else codes.numpy())


def _level(samples: NDArray, frames: int) -> NDArray:
    """Root mean square (T,) of the samples of each frame."""
    padded = np.zeros(frames * SAMPLES_PER_FRAME, np.float32)
    kept = samples[: len(padded)]
    padded[: len(kept)] = kept
    return np.sqrt((padded.reshape(frames, -1) ** 2).mean(axis=1))


def draw_curves(shown: Curves, axes: "list[Axes]") -> None:
    """Draw sound, speed and codes into three plots that share their time."""
    sound, speed, codes = axes
    times = np.arange(len(shown.speed)) / FPS
    if shown.level is not None:
        sound.fill_between(times, shown.level, color="0.75", linewidth=0)
        top = float(shown.level.max(initial=0)) or 1.0
        sound.vlines(shown.onsets, 0, top, color="tab:blue", linewidth=0.8, label="onsets")
        sound.plot(shown.beats, np.full(len(shown.beats), top), "v", color="tab:red", label="beats")
        sound.legend(loc="upper right", fontsize="small")
    sound.set_ylabel("sound")
    speed.plot(times, shown.speed, color="tab:green")
    speed.set_ylabel("speed of hands")
    if shown.codes is not None:
        edges = np.arange(shown.codes.shape[1] + 1) * FRAMES_PER_TOKEN / FPS
        for number, stream in enumerate(shown.codes):
            codes.stairs(stream, edges, label=("shift", "extent")[number % 2], linewidth=1.5)
        codes.legend(loc="upper right", fontsize="small")
    codes.set_ylabel("codes")
    codes.set_xlabel("seconds")
    for one in axes:
        one.set_xlim(0, max(len(times) / FPS, 1 / FPS))
        one.set_yticks([])


def figure_of(shown: Curves) -> "Figure":
    """The curves alone, for a page."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 4), layout="constrained")
    draw_curves(shown, list(figure.subplots(3, 1, sharex=True)))
    return figure


def write_sheet(
    video: GestureVideo, pipeline: "GesturePipeline", path: Path, *, force: bool = False
) -> str:
    """Write the sheet of a video as .png: frames with their regions as ellipses, and the curves.

    Args:
        video: from the pipeline; only a few of its frames are drawn, at 256 pixels.
        pipeline: that made it.
        path: of the picture.
        force: replace an existing file.

    Returns:
        a line that says what was written.

    Raises:
        BadInput: see `curves`, or an output that cannot be written.
    """
    from matplotlib.figure import Figure

    check_apart(path, video.inputs)
    shown = curves(video, pipeline)
    assert video.motion is not None and video.pose is not None
    places = (np.arange(FRAMES) + 0.5) * video.motion.frames / FRAMES
    numbers = sorted(set(places.astype(int).tolist()))
    chosen = Motion(video.motion.shift[numbers], video.motion.cholesky[numbers])
    drawn = render(
        pipeline.tracking(False), video.subject.picture, video.pose, chosen, pipeline.precision
    )
    figure = Figure(figsize=(12, 6.2), layout="constrained")
    halves: Any = figure.subfigures(2, 1, height_ratios=(1, 1.8))
    above, below = halves
    tiles = above.subplots(1, len(numbers), squeeze=False)[0]
    for number, tile, picture, region in zip(
        numbers, tiles, np.concatenate(list(drawn)), _ellipses(chosen), strict=True
    ):
        tile.imshow(picture, extent=(-1, 1, 1, -1))
        for ellipse in region:
            tile.add_patch(ellipse)
        tile.set_title(f"{number / FPS:.2f} s", fontsize="small")
        tile.set_axis_off()
    draw_curves(shown, list(below.subplots(3, 1, sharex=True)))
    with whole_file(path, force=force) as part:
        figure.savefig(part, dpi=110, format="png")
    return f"{path}: {len(numbers)} of {video.motion.frames} frames, {len(shown.onsets)} onsets"


def _ellipses(motion: Motion) -> list[list[Any]]:
    """Ellipses of the regions of each frame."""
    from matplotlib import colormaps
    from matplotlib.patches import Ellipse

    values, vectors = np.linalg.eigh(motion.covariance().numpy())  # (T, K, 2), (T, K, 2, 2)
    sides = 2 * SIGMAS * np.sqrt(values.clip(0))
    turns = np.degrees(np.arctan2(vectors[..., 1, 0], vectors[..., 0, 0]))
    colours = colormaps["hsv"](np.arange(motion.regions) / motion.regions)
    return [
        [
            Ellipse(tuple(centre), *side, angle=turn, fill=False, edgecolor=colour)
            for centre, side, turn, colour in zip(*frame, colours, strict=True)
        ]
        for frame in zip(motion.shift.numpy(), sides, turns, strict=True)
    ]
