"""Photo and recording to a gesture video: photo, features, motion, frames, mp4.

pipe = GesturePipeline.from_pretrained()
video = pipe("photo.jpg", "speech.wav", seed=1)
video.save("out.mp4")
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from angie.bundle import BUNDLE, Bundle
from angie.generators import family
from angie.generators.base import Family, GestureGenerator
from angie.motion.amplitude import check_amplitude, held_back, scale_displacement
from angie.motion.ends import faded, rest_pose
from angie.motion.saved import SavedMotion, load_motion
from angie.motion.statistics import MotionStatistics
from angie.provenance import bundle_hash
from angie.source import Photo, View, frame_photo
from angie.style import check_style
from angie.video import GestureVideo, Subject
from data_prep.errors import BadInput, check_choice, check_seed
from data_prep.media.audio import read_sound
from data_prep.progress import Listener, Step, listening, tell
from data_prep.rates import FPS, IMAGE_SIZE
from data_prep.speaker.crop import cut_out
from data_prep.speech.features import FEATURES, Speech, mono
from data_prep.speech.transcript import read_transcript
from data_prep.speech.words import Word
from mraa.affine import WITH_AXES
from mraa.draw import render, source_pose
from mraa.motion import Motion
from mraa.renderer import Renderer, from_pixels
from mraa.training.devices import choose_precision, keep_memory

Audio = Path | str | tuple[NDArray, int]
"""A recording or a video with sound; or samples (N,) or (N, 2) and their rate: floats in [-1, 1],
or whole numbers of 16 or 32 bits."""

SCALES = ("none", "hull")

STARTS = ("photo", "rest")


class GesturePipeline:
    """Photo and recording in, a video of that person gesturing out.

    Args:
        bundle: a speaker bundle.
        generator: which of its generators; None is the default one.
        device: torch device of the renderer.
        precision: of the renderer's convolutions, as `mraa.fast.session.RenderSession`, and of
            the generator, as `Bundle.generator`: "auto", "fp32", "bf16" or "fp16".

    Raises:
        BadInput: a device or precision that cannot be.
    """

    def __init__(
        self,
        bundle: Bundle,
        generator: str | None = None,
        *,
        device: str = "cpu",
        precision: str = "auto",
    ) -> None:
        try:
            place = torch.empty(0, device=device).device
        except (RuntimeError, AssertionError) as error:  # the latter by a torch without CUDA
            raise BadInput(f"--device {device}: not on this machine ({error})") from error
        try:
            choose_precision(precision, place)
        except ValueError as error:
            raise BadInput(f"--precision {precision}: {error}") from error
        self.bundle, self.name = bundle, generator
        self.device, self.precision = device, precision

    @classmethod
    def from_pretrained(
        cls,
        folder: Path | str | None = None,
        generator: str | None = None,
        *,
        device: str = "cpu",
        precision: str = "auto",
    ) -> "GesturePipeline":
        """The pipeline of a bundle's folder, or of the bundle that ships; its parts are loaded.

        Raises:
            BadInput: no bundle, or one that lacks a part.
        """
        bundle = Bundle.open(BUNDLE if folder is None else Path(folder))
        pipeline = cls(bundle, generator, device=device, precision=precision)
        _ = pipeline.generator, pipeline.renderer  # loaded now, so that what is missing is told
        return pipeline

    @cached_property
    def renderer(self) -> Renderer:
        """Regions of pictures, and pictures of regions; on the device."""
        return self.bundle.renderer().to(self.device)

    @cached_property
    def generator(self) -> GestureGenerator:
        """Speech to region motion; on the CPU."""
        return self.bundle.generator(self.name, precision=self.precision)

    @cached_property
    def regions(self) -> str:
        """Hash of the region estimator."""
        return self.bundle.regions()

    @property
    def place(self) -> str:
        """What draws: type of device and of its numbers, such as "cpu bfloat16"."""
        place = torch.device(self.device)
        return f"{place.type} {choose_precision(self.precision, place)}".replace("torch.", "")

    @property
    def family(self) -> Family:
        """What the generator is of."""
        return family(self.bundle.chosen(self.name))

    @cached_property
    def statistics(self) -> MotionStatistics:
        """Of the motion that the generator was trained on."""
        return self.bundle.statistics()

    def __call__(
        self,
        photo: Photo,
        audio: Audio,
        *,
        seed: int = 0,
        style: str | None = None,
        greedy: bool = False,
        scale_motion: str = "none",
        amplitude: float = 1.0,
        temperature: float | None = None,
        start: str = "photo",
        fade: float = 0.0,
        controls: Any = None,
        view: View | None = None,
        speech: Speech | None = None,
        words: Path | str | Sequence[Word] | None = None,
        callback: Listener | None = None,
    ) -> GestureVideo:
        """Make the person of a photo gesture to a recording.

        Args:
            photo: a picture file, turned upright by its EXIF tag; a picture of Pillow's; or
                pixels (H, W, 3) uint8 RGB.
            audio: a recording or a video with sound; or samples and their rate, see `Audio`.
            seed: of the gestures; the same seed gives the same video.
            style: a training speaker whose way of gesturing is taken, or what else
                `angie.generators.base.read_style` reads; the pose to begin with and to return to
                stays the photo's. None gestures like anyone.
            greedy: always the likeliest gesture; every seed then gives the same video. Else
                gestures are sampled. Both whatever the bundle's settings say.
            scale_motion: "hull" scales the gestures by the size of the person (spanned by the
                regions) against the training speakers', or that of `style`; "none" does not.
            amplitude: 0 to 2, how far from the photo's pose the gestures go: 1 is as they are made,
                but for regions that are not sure of themselves, see `angie.motion.amplitude`.
            temperature: how daring the sampling is, above 0: the likelier gestures are the likelier
                the lower it is; None as the bundle's settings say.
            start: pose to begin with: the "photo"'s, or that of a training speaker at "rest" (of
                `style`, else the mean), moved to the photo's person.
            fade: seconds at the end in which the motion goes back to the pose it began with.
            controls: a dataclass of the generator's own.
            view: which part of the photo moves, and what is shown of it.
            speech: the recording with features that are known already; others are computed.
            words: of the recording: a transcript of any format that `angie prepare` reads, plain
                text among them, or words with their times; for generators that read words.
            callback: told how far the work is; what it raises ends it, see `GestureVideo.save`.

        Raises:
            BadInput: an input that cannot be used.
        """
        view = view or View()
        check_seed(seed)
        check_choice("--scale-motion", scale_motion, SCALES)
        check_amplitude(amplitude)
        check_choice("--start", start, STARTS)
        if not 0 <= fade < float("inf"):
            raise BadInput(f"--fade {fade:g}: give seconds, 0 or more")
        controls = self.family.with_temperature(controls, temperature, greedy)
        check_style(self.bundle, style, self.name)
        with listening(callback):
            tell(Step("photo", 0, 1, "photos"))
            subject = self.subject(photo, view)
            tell(Step("sound", 0, 1, "recordings"))
            heard = speech
            whole = heard is not None and all(name in heard for name in self.generator.features)
            if words is not None or heard is None or not whole:
                said = heard.words if heard is not None and words is None else words
                speech = self.speech(audio, said)
            assert speech is not None
            pose = source_pose(self.renderer, subject.picture)
            begin = pose if start == "photo" else rest_pose(pose, self.statistics, style)
            tell(Step("gestures", 0, speech.frames, "frames"))
            motion = self.generator.generate(
                speech, begin, speech.frames, seed=seed, style=style, controls=controls,
                greedy=greedy,
            )  # fmt: skip
        if speech is not heard:
            speech.forget_samples()  # those of long recordings, which the renderer does not need
        if scale_motion == "hull":
            motion = scale_displacement(motion, begin, self.statistics, style)
        motion, note = held_back(motion, begin, self.statistics, amplitude)
        motion = faded(motion, begin, round(fade * FPS))
        settings = {
            "seed": seed, "style": style, "greedy": greedy, "scale_motion": scale_motion,
            "amplitude": amplitude, "temperature": temperature, "start": start, "fade": fade,
        }  # fmt: skip
        settings |= {} if controls is None or temperature else {"controls": str(controls)}
        given = {"photo": photo, "sound": audio} | ({} if words is None else {"words": words})
        record = self.record("gestures", settings, subject, view, **given)
        sound = audio if isinstance(audio, tuple) else Path(audio)
        video = self._video(subject, pose, motion, view, record)
        return replace(
            video, sound=sound, speech=speech, seconds=speech.seconds,
            notes=[*self.notes(speech), *note],
        )  # fmt: skip

    def render(
        self,
        photo: Photo,
        motion: SavedMotion | Path | str,
        audio: Path | str | None = None,
        *,
        view: View | None = None,
    ) -> GestureVideo:
        """Draw motion that was saved, on the photo that it was made for or on another.

        Args:
            photo: as in `__call__`.
            motion: as `angie.load_motion` reads it, or its file.
            audio: a recording to go with it, cut or followed by silence where its length is
                another; None makes a silent video.
            view: as in `__call__`.

        Raises:
            BadInput: an input that cannot be used, or motion of another renderer's regions.
        """
        view = view or View()
        path = Path(motion) if isinstance(motion, str | Path) else None
        saved = motion if isinstance(motion, SavedMotion) else load_motion(motion)
        if saved.regions not in ("", self.regions):
            raise BadInput(f"{path or 'motion'}: is of another bundle's regions; draw it with that")
        subject = self.subject(photo, view)
        pose = source_pose(self.renderer, subject.picture)
        if pose.regions != saved.motion.regions:
            raise BadInput(
                f"{path or 'motion'}: has {saved.motion.regions} regions, the bundle {pose.regions}"
            )
        moved = saved.on(pose)
        known = moved.vector().numpy() if path is None else path
        inputs = {"photo": photo, "motion": known} | ({} if audio is None else {"sound": audio})
        video = self._video(
            subject, pose, moved, view, self.record("motion", {}, subject, view, **inputs)
        )
        if audio is None:
            return video
        return replace(
            video, sound=Path(audio), seconds=moved.frames / FPS, fit=True,
            if_cut=f"{audio} is longer than the motion and was cut at its end",
        )  # fmt: skip

    def record(
        self, method: str, settings: dict[str, Any], subject: Subject, view: View, **inputs: Any
    ) -> dict[str, Any]:
        """What `angie.provenance.manifest` is made of."""
        generator = self.bundle.chosen(self.name) if method == "gestures" else None
        crop = subject.crop
        return {
            "method": method,
            "bundle": bundle_hash(self.bundle, generator),
            "regions": self.regions,
            "generator": generator or "",
            "device": self.place,
            "settings": {
                **settings,
                "crop": f"{crop.x},{crop.y},{crop.size}",
                "size": view.size,
                "full_frame": view.full_frame,
                "track_axes": view.track_axes,
            },
            "inputs": inputs,
        }

    def _video(
        self, subject: Subject, pose: Motion, motion: Motion, view: View, record: dict[str, Any]
    ) -> GestureVideo:
        """A silent video of motion."""

        def draw() -> Iterator[NDArray[np.uint8]]:
            keep_memory()  # from here on: what came before has given its memory back
            return render(
                self.tracking(view.track_axes), subject.picture, pose, motion, self.precision,
                subject.canvas, view.track_axes,
            )  # fmt: skip

        inputs = record["inputs"].values()
        files = tuple(Path(given) for given in inputs if isinstance(given, str | Path))
        return GestureVideo(
            subject, motion.frames, 0.0, draw, None, motion, pose, record=record, inputs=files
        )

    def subject(self, photo: Photo, view: View) -> Subject:
        """Read a photo and find its person.

        Raises:
            BadInput: a photo or a view that cannot be used.
        """
        shown, crop = frame_photo(photo, view)
        config = self.renderer.config
        if view.track_axes and config.affine_mode not in WITH_AXES:
            raise BadInput(
                f"--track-axes: regions of this bundle have no axes (they are {config.affine_mode})"
            )
        canvas = shown.canvas(align_corners=config.align_corners)
        if canvas is not None and not config.skips:
            raise BadInput("this bundle's renderer moves no photo; there is --size 256 only")
        cut = torch.from_numpy(cut_out(shown.photo, shown.crop, IMAGE_SIZE))
        path = Path(photo) if isinstance(photo, str | Path) else None
        return Subject(from_pixels(cut[None]).to(self.device), crop, shown, canvas, path)

    def speech(self, audio: Audio, words: Path | str | Sequence[Word] | None = None) -> Speech:
        """A recording with the features and words that the generator reads.

        The samples are forgotten, where the features are all that the generator reads: long
        recordings leave their memory to the renderer.

        Args:
            audio: the recording.
            words: a transcript, or words with their times; text without times is aligned.

        Raises:
            BadInput: a recording or a transcript that cannot be used.
        """
        if not isinstance(audio, tuple | str | Path):
            raise BadInput(
                f"audio: give a file, or samples and their rate as (array, rate), not "
                f"{type(audio).__name__}"
            )
        samples = mono(*audio) if isinstance(audio, tuple) else read_sound(Path(audio))
        if isinstance(words, str | Path):
            words = read_transcript(Path(words)).aligned(samples)
        speech = Speech(samples, words)
        known = [name for name in self.generator.features if name in FEATURES]
        for name in known:
            speech[name]
        if len(known) == len(self.generator.features):
            speech.forget_samples()
        return speech

    def notes(self, speech: Speech) -> list[str]:
        """What is to be said of the words of a recording, a line or none."""
        reads = "words" in self.generator.features
        if reads and not speech.words:
            return ["gestures without words; --words FILE gives a transcript"]
        if speech.words and not reads:
            return ["the words are not used: this generator hears sound only"]
        return []

    def tracking(self, track_axes: bool) -> Renderer:
        """The renderer, told whether signs and order of the axes of regions are meant."""
        config = self.renderer.config
        self.renderer.flow.revert_axis_swap = config.revert_axis_swap and not track_axes
        return self.renderer
