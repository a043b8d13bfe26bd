"""The one interface of gesture generators: how they are asked, trained, stored and found.

A generator turns speech and a start pose into region motion. What it consists of, how that is
trained and how it is loaded is its `Family`; `angie.generators` is the registry of families.
Whatever stands outside a family's own folder knows these classes alone.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, NoReturn, Protocol

import torch
from torch import Tensor

from angie.generators.stages import Parts, Stage
from angie.motion.clips import MotionClip
from angie.motion.statistics import MotionStatistics, known
from data_prep.errors import BadInput
from data_prep.rates import FPS
from mraa.motion import Motion

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from data_prep.speech.features import Speech


class GestureStream(Protocol):
    """Gestures to sound that is still coming in."""

    def push(self, samples: "NDArray") -> Motion:
        """Take sound (N,) float32 at 16 kHz; the frames, at 25 a second, that are settled now."""
        ...

    def finish(self) -> Motion:
        """The frames that were still open: the sound has ended."""
        ...


class GestureGenerator(Protocol):
    """Speech and a start pose in, region motion out.

    Attributes:
        fps: frames a second that the generator works at; callers see 25 whatever it is.
        features: names of the features of `Speech` that it reads; "waveform" and "words" are its
            samples and its words themselves.
        lookahead: seconds of sound after a frame that it has to know; None: the whole recording.
    """

    fps: int
    features: tuple[str, ...]
    lookahead: float | None

    @property
    def random(self) -> bool:
        """Whether the seed matters where `greedy` is None."""
        return True

    def generate(
        self,
        speech: "Speech",
        start: Motion,
        frames: int,
        *,
        seed: int = 0,
        speaker: str | None = None,
        style: str | Tensor | None = None,
        seed_motion: Motion | None = None,
        controls: Any = None,
        greedy: bool | None = False,
    ) -> Motion:
        """Gesture to speech.

        Args:
            speech: the whole recording, at least `frames` frames of 1/25 s long.
            start: pose of the photo, one frame: shift (1, K, 2), cholesky (1, K, 3).
            frames: number of frames T to make, 25 a second.
            seed: everything random follows from it; one seed gives one motion on one device.
            speaker: a speaker of the training set who gestures: in their style, and around their
                rest pose; None is anyone.
            style: a training speaker whose way of gesturing alone is taken, by name, or what
                else `read_style` reads, or a point of the family's own style space; None takes
                that of `speaker`.
            seed_motion: recorded motion at 25 fps whose beginning the generator may take, as its
                paper's protocol has it.
            controls: a dataclass of the family's own, or None.
            greedy: True draws nothing at random, False samples, None does what the settings say.

        Returns:
            Motion of exactly T frames on the CPU; frame 1 is the start pose.

        Raises:
            ValueError: too little speech for `frames`, or a start pose of other regions.
            BadInput: an unknown speaker or style, or one that the generator cannot tell apart.
        """
        ...

    def stream(
        self,
        start: Motion,
        *,
        seed: int = 0,
        style: str | Tensor | None = None,
        controls: Any = None,
    ) -> GestureStream:
        """Begin to gesture to sound that comes in piece by piece.

        Raises:
            NotImplementedError: `lookahead` is None.
        """
        no_stream(type(self).__name__)


def read_style(style: str, speakers: Sequence[str], size: int) -> dict[str, float] | Tensor:
    """What `--style` says: a speaker, a mixture of speakers, or a point of a style space.

    Args:
        style: "NAME", "A:0.3,B:0.7" or numbers that are separated by commas.
        speakers: names that there are.
        size: numbers of a point; 0 where a generator knows styles by names only.

    Returns:
        the weight of each speaker, above 0 in all; or a point (size,).

    Raises:
        BadInput: none of these.
    """
    if not size and style not in speakers and set(style) & set(":,"):
        raise BadInput(
            f"--style {style}: not a speaker of this model, which knows styles by name alone "
            f"({', '.join(speakers)})"
        )
    if style in speakers or not size:
        return {known(style, speakers): 1.0}
    parts = style.split(",")
    try:
        if ":" not in style and len(parts) > 1:
            point = torch.tensor([float(part) for part in parts])
            if len(parts) == size and bool(point.isfinite().all()):
                return point
            raise ValueError
        if ":" in style:
            pairs = [part.rsplit(":", 1) for part in parts]
            mixed = {known(name.strip(), speakers): float(weight) for name, weight in pairs}
            if min(mixed.values()) >= 0 and 0 < sum(mixed.values()) < math.inf:
                return mixed
            raise ValueError
    except ValueError:
        raise BadInput(
            f"--style {style}: give NAME, a mixture such as {speakers[0]}:0.3,{speakers[-1]}:0.7, "
            f"or {size} numbers separated by commas"
        ) from None
    return {known(style, speakers): 1.0}


def no_stream(name: str) -> NoReturn:
    """Refuse to stream: the generator needs the whole recording at once."""
    raise NotImplementedError(f"{name} needs the whole recording at once; it cannot stream")


class ResamplingGenerator(GestureGenerator, Protocol):
    """A generator that works at another rate than 25 fps.

    Subclasses state `fps` and implement `generate_own`, in which the start pose, `frames`,
    `seed_motion` and the result are at that rate.

    Attributes:
        smooth: resample by splines, for which the whole motion has to be known, see `resample`.
    """

    smooth: bool = False

    def generate_own(
        self,
        speech: "Speech",
        start: Motion,
        frames: int,
        *,
        seed: int = 0,
        speaker: str | None = None,
        style: str | Tensor | None = None,
        seed_motion: Motion | None = None,
        controls: Any = None,
        greedy: bool | None = False,
    ) -> Motion:
        """`generate` at the generator's own rate."""
        ...

    def generate(
        self, speech: "Speech", start: Motion, frames: int, *,
        seed_motion: Motion | None = None, **options: Any,
    ) -> Motion:  # fmt: skip
        """Generate at the own rate and resample; see `GestureGenerator.generate`."""
        own = math.ceil((frames - 1) * self.fps / FPS) + 1  # the last frame lies at or after T
        smooth = self.smooth
        if seed_motion is not None:
            seed_motion = resample(seed_motion, FPS, self.fps, smooth=smooth)
        motion = self.generate_own(speech, start, own, seed_motion=seed_motion, **options)
        return resample(motion, self.fps, FPS, frames, smooth=smooth)


def resample(
    motion: Motion, rate: float, to: float, frames: int | None = None, *, smooth: bool = False
) -> Motion:
    """Motion at another frame rate by linear interpolation; the first frame stays as it is.

    Args:
        motion: T frames.
        rate: frames a second of `motion`.
        to: frames a second wanted.
        frames: wanted; None is all up to the last frame of `motion`. Frames after that repeat it.
        smooth: to a higher rate by cubic splines, the diagonals of Cholesky factors by those of
            their logarithms; to a lower one after a Gaussian, which reaches the first frame, too.
    """
    if smooth and rate != to and motion.frames > 1:
        from angie.motion.keypoints import resample as resample_points  # SciPy takes a while

        curves = logarithmic(motion).double().numpy()[:, None]
        made = torch.from_numpy(resample_points(curves, rate, to)[:, 0]).to(motion.shift.dtype)
        first, motion = motion.vector()[:1], exponential(made, motion)
        if to > rate:  # exactly
            motion = motion.like(torch.cat([first, motion.vector()[1:]]))
        rate = to
    vector, last = motion.vector(), motion.frames - 1
    if frames is None:
        frames = math.floor(last * to / rate + 1e-6) + 1
    place = (torch.arange(frames, dtype=torch.float64) * rate / to).clamp_max(last)
    low = place.floor().long()
    share = (place - low).to(vector.dtype)[:, None]
    return motion.like(vector[low] * (1 - share) + vector[(low + 1).clamp_max(last)] * share)


def logarithmic(motion: Motion) -> Tensor:
    """Motion vectors (T, C) with logarithms in place of l1 and l3, which are above 0."""
    if not motion.has_extent:
        return motion.vector()
    l1, l2, l3 = motion.cholesky.unbind(-1)
    factor = torch.stack([l1.log(), l2, l3.log()], dim=-1)
    return Motion(motion.shift, factor).vector()


def exponential(vector: Tensor, like: Motion) -> Motion:
    """Motion of what `logarithmic` gives, of regions or points as another motion."""
    motion = like.like(vector)
    if not motion.has_extent:
        return motion
    l1, l2, l3 = motion.cholesky.unbind(-1)
    return Motion(motion.shift, torch.stack([l1.exp(), l2, l3.exp()], dim=-1))


def begin_at(motion: Motion, start: Motion, fps: float, seconds: float = 1.0) -> Motion:
    """Motion that begins with a pose: what it is off in frame 1 is added and dies away.

    For generators whose motion is absolute. Diagonals of Cholesky factors are multiplied in place
    of that, so that they stay positive.

    Args:
        motion: T frames; diagonals above 0.
        start: one frame.
        fps: frames a second.
        seconds: in which the offset falls to 1 / e.

    Returns:
        T frames, the first of which is the start pose.
    """
    vector, pose = logarithmic(motion), logarithmic(start)
    left = torch.exp(-torch.arange(len(vector)) / (fps * seconds))[:, None].to(vector)
    made = exponential(vector + left * (pose - vector[:1]), motion).vector()
    return motion.like(torch.cat([start.vector(), made[1:]]))


HOTTEST = 5.0
"""Highest temperature."""


@dataclass(frozen=True)
class Variant:
    """Settings of a row of a paper's table of ablations.

    Attributes:
        change: the settings of the variant from those of the family.
        parts_of: a variant whose parts serve this one as well; None trains its own.
        several: whether it is one of those that a comparison trains with several seeds.
    """

    change: Callable[[Any], Any]
    parts_of: str | None = None
    several: bool = False


@dataclass(frozen=True)
class Family:
    """A kind of generator.

    Attributes:
        name: in bundles, options and settings; letters, digits and "_".
        title: for people, such as "ANGIE (NeurIPS 2022)".
        settings: a frozen dataclass with a default for every field.
        stages: of training, in their order.
        load: the generator of a bundle, at a precision ("fp32", "bf16", "auto").
        presets: settings by the name of the bundle's preset; without one, `settings()`.
        fit: settings for motion of that many regions, or of points without extent.
        styles: names of the styles that such settings tell apart; none if there is but one.
        style_space: numbers of a point of the style space under these settings; 0 without one.
        style_draws: so many styles (n, Z) of each training speaker, for the report; None where
            there is no style space.
        style_advice: how a model with several styles is trained, for a message.
        variants: of ablations, in the order of the table.
        columns: of that table, beside the scores: shares of the frames of clips.
        controls: a frozen dataclass of what can be asked of a generator beside the sound, with a
            default for every field; `temperature` is what `--temperature` sets. None has none.
        report: what `angie info` says of a part, a phrase each, from its report and the settings.
        codes_shown: draws codes on photos, for `angie codebook`: from a bundle, photos and the
            output, with `count`, `person` and `force`; None where a generator has no codes.
        reconstruct: a clip's motion through the generator's own tokens, given its name as
            `speaker` or None; None where a generator has none.
    """

    name: str
    title: str
    settings: type
    stages: tuple[Stage, ...]
    load: Callable[[Parts, str], GestureGenerator]
    presets: Mapping[str, Callable[[], Any]] = field(default_factory=dict)
    fit: Callable[[Any, int, bool], Any] = lambda settings, regions, points: settings
    styles: Callable[[Any, MotionStatistics], tuple[str, ...]] = lambda settings, statistics: ()
    style_space: Callable[[Any], int] = lambda settings: 0
    style_draws: Callable[[GestureGenerator, int], dict[str, Tensor]] | None = None
    style_advice: str = ""
    variants: Mapping[str, Variant] = field(default_factory=dict)
    columns: Mapping[str, Callable[[GestureGenerator, Sequence[MotionClip]], float]] = field(
        default_factory=dict
    )
    controls: type | None = None
    report: Callable[[str, dict[str, Any], Any], list[str]] = lambda stage, report, settings: []
    codes_shown: Callable[..., str] | None = None
    reconstruct: Callable[[GestureGenerator, MotionClip, str | None], Motion] | None = None

    def preset(self, name: str) -> Any:
        """Settings for a bundle of this preset."""
        return self.presets.get(name, self.settings)()

    def stage(self, name: str) -> Stage:
        """The stage of a name."""
        return next(stage for stage in self.stages if stage.name == name)

    def wanted(self, settings: Any) -> list[Stage]:
        """The stages that there are under these settings."""
        return [stage for stage in self.stages if stage.wanted(settings)]

    def with_temperature(self, controls: Any, temperature: float | None, greedy: bool) -> Any:
        """Controls of a generator with a temperature among them; None leaves them as they are.

        Raises:
            BadInput: a temperature that cannot be, or a generator that knows none.
        """
        if temperature is None:
            return controls
        if not 0 < temperature <= HOTTEST:
            raise BadInput(f"--temperature {temperature:g}: give a number above 0, at most 5")
        if greedy:
            raise BadInput("--greedy and --temperature: give one; the likeliest gesture has none")
        kind = self.controls
        if kind is None or "temperature" not in {entry.name for entry in fields(kind)}:
            raise BadInput(f"--temperature: {self.name} does not draw its gestures by temperature")
        return replace(kind() if controls is None else controls, temperature=temperature)
