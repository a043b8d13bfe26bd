"""What is asked of a video: the options of `angie animate`, by their names.

The command, lists of jobs, the service and the page all make the same request; the pipeline's
libraries are imported when it is carried out.
"""

import dataclasses
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from data_prep.errors import BadInput, check_choice
from data_prep.files import want_file

if TYPE_CHECKING:
    from angie.pipeline import GesturePipeline
    from angie.video import GestureVideo
    from data_prep.progress import Listener
    from data_prep.speaker.crop import Crop
    from data_prep.speech.features import Speech


@dataclass(frozen=True)
class Request:
    """A video that is asked for; each attribute is the option of that name.

    Attributes:
        photo: any photo of a person.
        audio: any recording, or a video with sound.
        drive: a video whose motion is taken.
        motion: a file of saved motion.
        words: transcript of the recording.
        speaker: bundle; None is the one that ships.
        generator: of the bundle; None is the default one.
        seed, style, greedy, scale_motion, amplitude, temperature, start, fade: as in
            `GesturePipeline`.
        crop, person, models, size, full_frame, track_axes: as in `angie.source.View`.
        mode, drive_crop, drive_person: as in `angie.drive.Driving`.
        format: as in `GestureVideo.save`.
        consent: how the person of the photo agreed.
    """

    photo: Path
    audio: Path | None = None
    drive: Path | None = None
    motion: Path | None = None
    words: Path | None = None
    speaker: Path | None = None
    generator: str | None = None
    seed: int = 0
    style: str | None = None
    greedy: bool = False
    scale_motion: str = "none"
    amplitude: float = 1.0
    temperature: float | None = None
    start: str = "photo"
    fade: float = 0.0
    crop: str | None = None
    person: str | None = None
    models: Path | None = None
    size: str | None = None
    full_frame: bool = False
    track_axes: bool = False
    mode: str | None = None
    drive_crop: str | None = None
    drive_person: str | None = None
    format: str | None = None
    consent: str = ""

    @classmethod
    def read(cls, options: Mapping[str, str], folder: Path = Path()) -> "Request":
        """A request of words, as tables and forms have them; empty ones are left out.

        Args:
            options: by name, with dashes or underscores.
            folder: what files are looked for in, if their names do not begin at the root.

        Raises:
            BadInput: an unknown option, one that is missing, or a value that cannot be.
        """
        given: dict[str, Any] = {}
        for option, text in options.items():
            name = option.strip().removeprefix("--").replace("-", "_")
            if name not in _KINDS:
                known = ", ".join(sorted(_KINDS))
                raise BadInput(f"{option}: no such option of a video; there are {known}")
            if text.strip():
                given[name] = _value(name, text.strip(), folder)
        if "photo" not in given:
            raise BadInput("photo: is missing; give the photo of a person")
        return cls(**given)

    @property
    def inputs(self) -> list[Path]:
        """Files that are read."""
        files = (self.photo, self.audio, self.drive, self.motion, self.words)
        return [path for path in files if path is not None]

    def changed(self, names: tuple[str, ...]) -> list[str]:
        """Those of the options that are not as they are by default."""
        return [name for name in names if getattr(self, name) != OPTIONS[name]]

    def check(self) -> None:
        """Refuse what cannot be carried out, as far as that can be told without reading files.

        Raises:
            BadInput: which option, and what would be right.
        """
        for path, what in zip(
            (self.photo, self.audio, self.drive, self.motion, self.words),
            ("photo", "recording", "driving video", "saved motion", "transcript"),
            strict=True,
        ):
            if path is not None:
                want_file(path, what)
        check_choice("--scale-motion", self.scale_motion, ("none", "hull"))
        check_choice("--start", self.start, ("photo", "rest"))
        if self.crop is not None:
            square_of(self.crop)
        if self.drive is not None and self.motion is not None:
            raise BadInput("--drive and --motion: give one; both say how the person moves")
        if self.drive is not None or self.motion is not None:
            if self.changed(OF_SPEECH):
                names = ", ".join("--" + name.replace("_", "-") for name in OF_SPEECH[:-1])
                what = "--drive" if self.drive is not None else "--motion"
                raise BadInput(
                    f"{names} and --{OF_SPEECH[-1]} are for gestures to sound, not for {what}"
                )
        elif self.audio is None:
            raise BadInput(
                "give a recording to gesture to, or a video to follow with --drive VIDEO"
            )
        if self.drive is None and self.changed(OF_DRIVING):
            raise BadInput("--mode, --drive-crop and --drive-person go with --drive VIDEO")

    def make(
        self,
        pipeline: "GesturePipeline",
        *,
        crop: "Crop | None" = None,
        speech: "Speech | None" = None,
        callback: "Listener | None" = None,
    ) -> "GestureVideo":
        """Carry it out, up to the frames, which are drawn when the video is saved.

        Args:
            pipeline: of the bundle and the generator that are asked for.
            crop: square of the photo, if it was found already.
            speech: the recording with its features, if they are known already.
            callback: told how far the work is.

        Raises:
            BadInput: an input that cannot be used.
        """
        from angie.source import View

        if self.crop is not None:
            crop = square_of(self.crop)
        view = View(
            crop=crop, person=self.person, models=self.models, size=self.size,
            full_frame=self.full_frame, track_axes=self.track_axes,
        )  # fmt: skip
        if self.motion is not None:
            return pipeline.render(self.photo, self.motion, self.audio, view=view)
        if self.drive is not None:
            from angie.drive import Driving, drive

            corner = self.drive_crop and square_of(self.drive_crop, "--drive-crop")
            driving = Driving(self.mode, self.audio, corner or None, self.drive_person)
            return drive(pipeline, self.photo, self.drive, driving, view)
        assert self.audio is not None
        told = {name: getattr(self, name) for name in OF_SPEECH if name != "generator"}
        told |= {"view": view, "speech": speech, "callback": callback}
        return pipeline(self.photo, self.audio, seed=self.seed, **told)


OF_SPEECH = (
    "greedy", "style", "words", "scale_motion", "amplitude", "temperature", "start", "fade",
    "generator",
)  # fmt: skip
"""Options of gestures to sound, but for the seed."""

OF_DRIVING = ("mode", "drive_crop", "drive_person")

_KINDS = {entry.name: str(entry.type) for entry in dataclasses.fields(Request)}

OPTIONS = {entry.name: entry.default for entry in dataclasses.fields(Request)}
"""Names of all options with what they are by default."""

_TRUTHS = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}


def _value(name: str, text: str, folder: Path) -> Any:
    """The value of an option that is given as a word."""
    kind = _KINDS[name]
    if "Path" in kind:
        return folder / text
    read: Callable[[str], Any] = str
    if "bool" in kind:
        read = lambda word: _TRUTHS[word.lower()]  # noqa: E731
    elif "int" in kind or "float" in kind:
        read = int if "int" in kind else float
    try:
        return read(text)
    except (ValueError, KeyError):
        wanted = (
            "a whole number" if read is int else "a number" if read is float else "true or false"
        )
        raise BadInput(f"{name.replace('_', '-')} {text}: give {wanted}") from None


def square_of(text: str, option: str = "--crop") -> "Crop":
    """The square that `--crop` (or another option) names: x,y,size or x,y,w,h with equal sides.

    Raises:
        BadInput: anything else.
    """
    from data_prep.speaker.crop import Crop

    try:
        x, y, size, *height = (int(part) for part in text.split(","))
    except ValueError:
        raise BadInput(f"{option} {text}: give x,y,size in whole pixels") from None
    if len(height) > 1 or size < 1:
        raise BadInput(f"{option} {text}: give x,y,size in whole pixels, the size above 0")
    if height not in ([], [size]):
        raise BadInput(f"{option} {text}: is not a square; width and height must be equal")
    return Crop(x, y, size)


def device_of(name: str) -> str:
    """The torch device that `--device` names; "auto" takes the fastest there is.

    Raises:
        BadInput: unknown, or not on this machine.
    """
    import torch

    available = {"cpu": True, "cuda": torch.cuda.is_available()}
    available["mps"] = torch.backends.mps.is_available()
    if name == "auto":
        return next(d for d in ("cuda", "mps", "cpu") if available[d])
    kind, _, number = name.partition(":")
    count = torch.cuda.device_count() if kind == "cuda" else 1
    numbered = not number or (number.isdecimal() and int(number) < count)
    if not available.get(kind, False) or not numbered:
        usable = ", ".join(d for d, ok in available.items() if ok)
        raise BadInput(f"--device {name}: not on this machine; there is {usable}")
    return name


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Pipelines:
    """Pipelines by bundle and generator, each loaded once.

    Args:
        device: torch device, or "auto".
        precision: as in `GesturePipeline`.
    """

    def __init__(self, device: str = "auto", precision: str = "auto") -> None:
        self.device, self.precision = device, precision
        self._known: dict[tuple[Path, str | None], GesturePipeline] = {}

    def of(self, request: Request) -> "GesturePipeline":
        """The pipeline that a request needs.

        Raises:
            BadInput: a bundle or generator that cannot be used.
        """
        from angie.bundle import BUNDLE, Bundle
        from angie.pipeline import GesturePipeline

        key = (Path(request.speaker or BUNDLE).resolve(), request.generator)
        if key not in self._known:
            place = device_of(self.device)
            self._known[key] = GesturePipeline(
                Bundle.open(key[0]), request.generator, device=place, precision=self.precision
            )
        return self._known[key]
