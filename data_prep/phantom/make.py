"""Raw videos of the phantom speaker, with word times and the truth beside them."""

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from data_prep.errors import BadInput, check_choice
from data_prep.files import whole_file
from data_prep.media.writer import VideoWriter
from data_prep.phantom import espeak
from data_prep.phantom.figure import HEIGHT, WIDTH, Figure
from data_prep.phantom.gesture import Stroke, schedule
from data_prep.phantom.motion import course
from data_prep.phantom.presenters import Presenter, Setting, presenter, setting
from data_prep.phantom.script import script
from data_prep.phantom.skeleton import JOINTS, Course, Joints, joints
from data_prep.phantom.speech import Speech, speak
from data_prep.processes import spread
from data_prep.progress import progress
from data_prep.rates import FPS

COMMENT = "Synthetic: the phantom speaker of angie; no real person is shown or heard."
"""Metadata of every phantom video."""

VOICES = ("auto", "builtin", "espeak")
"""Choices of the voice: eSpeak NG where it is installed, else the built-in one; either."""

_LENGTH = 30.0
"""Seconds of one video, about."""


@dataclass(frozen=True)
class Take:
    """One video before it is drawn: who, where, what is said and how it is moved."""

    who: Presenter
    place: Setting
    speech: Speech
    strokes: list[Stroke]
    path: Course
    key: tuple[int, ...]  # seeds what is drawn at random
    voice: str

    @cached_property
    def joints(self) -> Joints:
        """Where the joints are in every frame."""
        return joints(self.path, self.who.look, self.place, WIDTH)

    @cached_property
    def figure(self) -> Figure:
        """What draws it; textures are made at the first use."""
        return self.figure_at(1)

    def figure_at(self, scale: int) -> Figure:
        """What draws it with `scale` pixels for each pixel along each side."""
        return Figure(self.who, self.place, self.path, list(self.key), scale)


def voice_named(name: str) -> str:
    """The voice "builtin" or "espeak" that a choice stands for; "auto" takes what is installed.

    Raises:
        BadInput: another name, or eSpeak NG is asked for and not installed.
    """
    check_choice("--voice", name, VOICES)
    if name == "espeak" and not espeak.installed():
        raise BadInput("--voice espeak: not found; install the package espeak-ng or use builtin")
    if name == "auto":
        return "espeak" if espeak.installed() else "builtin"
    return name


def take(
    index: int, number: int, *, seconds: float = _LENGTH, seed: int = 0, voice: str = "builtin"
) -> Take:
    """Video `number` of a presenter, ready to be drawn.

    Args:
        index: of the presenter, from 0.
        number: of the video, from 0; clothes, place and words change with it.
        seconds: about how long.
        seed: of everything.
        voice: "builtin" or "espeak".
    """
    key = [seed, index, number]
    who = presenter(index, seed)
    place = setting(who, np.random.default_rng([*key, 1]))
    phrases = script(seconds, who.voice.rate, np.random.default_rng([*key, 2]))
    say = espeak.speak if voice == "espeak" else speak
    speech = say(phrases, who.voice, np.random.default_rng([*key, 3]))
    strokes = schedule(speech, who.style, np.random.default_rng([*key, 4]))
    path = course(speech, strokes, who.style, np.random.default_rng([*key, 5]))
    return Take(who, place, speech, strokes, path, (*key, 6), voice)


def still(index: int, *, number: int = 0, seed: int = 0) -> NDArray[np.uint8]:
    """A photo of a presenter at rest, (360, 640, 3) uint8 RGB.

    Args:
        index: of the presenter, from 0.
        number: of the video whose clothes and place are shown.
        seed: of everything.
    """
    return take(index, number, seconds=3.0, seed=seed).figure.frame(0)


def recording(index: int, *, seconds: float = 10.0, number: int = 0, seed: int = 0) -> Speech:
    """A recording of a presenter's voice: `samples` (N,) float32 at `rate`, words and beats.

    Args:
        index: of the presenter, from 0.
        seconds: about how long.
        number: of the script.
        seed: of everything.
    """
    who = presenter(index, seed)
    key = [seed, index, number]
    phrases = script(seconds, who.voice.rate, np.random.default_rng([*key, 2]))
    return speak(phrases, who.voice, np.random.default_rng([*key, 3]))


def truth(shot: Take, seed: int) -> dict[str, NDArray]:
    """What is known about a take: the arrays of its `.truth.npz`.

    `joints` (T, J, 2) float32 pixels (x, y) with `joint_names` (J,); `stroke_label`,
    `stroke_hand` ("right", "left", "both"), `stroke_word` (index of the word), `stroke_called`
    (whether the word calls for it) and `stroke_onset`, `stroke_prepared`, `stroke_apex`,
    `stroke_end` in seconds, (n,) each; `beats` (m,) onsets of stressed vowels in seconds;
    `style_amplitude`, `style_right_hand`, `style_tempo` as in `presenters.Style`; `fps`,
    `seed`, `presenter`, `voice` ("builtin" or "espeak").
    """
    strokes = shot.strokes
    hand = ["both" if len(s.hands) == 2 else ("right", "left")[s.hands[0]] for s in strokes]
    return {
        "joints": shot.joints.points,
        "joint_names": np.array(JOINTS),
        "stroke_label": np.array([s.label for s in strokes], dtype="U16"),
        "stroke_hand": np.array(hand, dtype="U5"),
        "stroke_word": np.array([s.word for s in strokes], np.int64),
        "stroke_called": np.array([s.called for s in strokes], bool),
        "stroke_onset": np.array([s.onset for s in strokes], np.float64),
        "stroke_prepared": np.array([s.prepared for s in strokes], np.float64),
        "stroke_apex": np.array([s.apex for s in strokes], np.float64),
        "stroke_end": np.array([s.end for s in strokes], np.float64),
        "beats": shot.speech.beats.astype(np.float64),
        "style_amplitude": np.array(shot.who.style.amplitude),
        "style_right_hand": np.array(shot.who.style.right_hand),
        "style_tempo": np.array(shot.who.style.tempo),
        "fps": np.array(FPS),
        "seed": np.array(seed),
        "presenter": np.array(shot.who.name),
        "voice": np.array(shot.voice),
    }


@dataclass(frozen=True)
class _Order:
    path: str
    index: int
    number: int
    seconds: float
    seed: int
    voice: str


def _write(order: _Order) -> str:
    """Draw one video and write it with its words and truth; the video comes last."""
    cv2.setNumThreads(1)
    path = Path(order.path)
    shot = take(
        order.index, order.number, seconds=order.seconds, seed=order.seed, voice=order.voice
    )
    words = [
        {"word": w.word, "start": round(w.start, 4), "end": round(w.end, 4)}
        for w in shot.speech.words
    ]
    with whole_file(path.with_suffix(".words.json"), force=True) as part:
        part.write_text(json.dumps(words, indent=1) + "\n", encoding="utf-8")
    with whole_file(path.with_suffix(".truth.npz"), force=True) as part:
        np.savez(part, **truth(shot, order.seed))  # type: ignore[arg-type]
    with (
        whole_file(path, force=True) as part,
        VideoWriter(
            part,
            (WIDTH, HEIGHT),
            fps=FPS,
            sound=(shot.speech.samples, shot.speech.rate),
            comment=COMMENT,
            crf=19,
            threads=1,
        ) as video,
    ):
        for t in range(shot.joints.frames):
            video.write(shot.figure.frame(t))
    return order.path


def _orders(output: Path, minutes: float, seed: int, presenters: int, voice: str) -> list[_Order]:
    each = minutes * 60 / presenters
    count = max(1, round(each / _LENGTH))
    orders = []
    for number in range(count):
        for index in range(presenters):
            name = presenter(index, seed).name
            path = output / name / f"{name}_{number:03d}.mp4"
            orders.append(_Order(str(path), index, number, each / count, seed, voice))
    return orders


def make_phantom(
    output: Path,
    *,
    minutes: float,
    seed: int,
    presenters: int = 4,
    jobs: int = 1,
    voice: str = "builtin",
) -> list[Path]:
    """Write videos of phantom speakers: `output/<presenter>/<presenter>_<n>.mp4`.

    Each lasts about half a minute, 640x360 at 25 frames a second with sound; beside it lie
    `.words.json`, a list of {"word", "start", "end"} in seconds, and `.truth.npz` (see `truth`).

    Args:
        output: folder, made if it is missing; its parent must exist.
        minutes: of video in all, about.
        seed: everything follows from it.
        presenters: how many people.
        jobs: processes.
        voice: one of `VOICES`; what "auto" gives depends on the machine.

    Returns:
        The videos, by presenter and number.

    Raises:
        BadInput: a number that makes no sense, or a folder that cannot be written.
    """
    if not minutes > 0 or presenters < 1 or jobs < 1 or seed < 0:
        raise BadInput(
            f"{output}: minutes {minutes}, presenters {presenters}, jobs {jobs}, seed {seed} "
            "cannot be made; minutes, presenters and jobs must be above 0, the seed not below"
        )
    output = Path(output)
    orders = _orders(output, minutes, seed, presenters, voice_named(voice))
    try:
        output.mkdir(exist_ok=True)
        for order in orders:
            Path(order.path).parent.mkdir(exist_ok=True)
    except OSError as error:
        raise BadInput(f"{output}: cannot make the folder ({error.strerror})") from error
    done = []
    with progress("phantom", len(orders), "videos") as advance:
        for order, name in spread(_write, orders, jobs):
            if name is None:
                raise BadInput(f"{order.path}: its process died; take fewer --jobs")
            done.append(Path(name))
            advance(1, Path(name).name)
    return sorted(done)
