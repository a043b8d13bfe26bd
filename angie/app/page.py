"""The web page, by Gradio: a photo and a voice go in, the video comes out beside its curves."""

import os
import shutil
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

# Before Gradio is imported: it tells nobody of its use, and asks nobody for anything.
os.environ.update(GRADIO_ANALYTICS_ENABLED="False", HF_HUB_OFFLINE="1")

import gradio as gr
from PIL import Image

from angie import __version__
from angie.app.queue import CANCELLED, DONE, FAILED, RUNNING, Busy, Job, Queue
from angie.app.square import SMALLEST, found_square, moved_square, with_square
from angie.request import Request
from data_prep.errors import BadInput
from data_prep.speaker.crop import Crop

if TYPE_CHECKING:
    from fastapi import FastAPI

    from angie.pipeline import GesturePipeline
    from angie.video import GestureVideo

WAIT = 0.4
"""Seconds between two looks at a job."""

AGREED = (
    "I am the person in the photo, or they agreed to be animated. I will say that the video is "
    "synthetic wherever I show it."
)

CSS = """
.gradio-container {max-width: 1200px !important; margin: auto}
#status {min-height: 3em; padding: .5em 0; font-size: 1.05em}
#status progress {width: 100%; height: 1.1em}
#status [role=alert] {color: var(--error-text-color, #b91c1c)}
:focus-visible {outline: 3px solid #f59e0b !important; outline-offset: 2px}
"""


def with_page(app: "FastAPI", queue: Queue, speaker: Path | None) -> "FastAPI":
    """The service with the page at its root.

    Args:
        app: the service.
        queue: of both.
        speaker: bundle of every video; None is the one that ships.
    """
    cache = queue.root / "page"
    cache.mkdir(exist_ok=True)
    os.environ["GRADIO_TEMP_DIR"] = str(cache)
    theme = gr.themes.Default(
        font=["system-ui", "sans-serif"], font_mono=["ui-monospace", "monospace"]
    )
    return gr.mount_gradio_app(
        app,
        Page(queue, speaker).blocks(),
        "/",
        max_file_size=queue.limits.upload,
        footer_links=[],
        theme=theme,
        css=CSS,
        enable_monitoring=False,
        ssr_mode=False,
    )


class Page:
    """What the page shows and does.

    Args:
        queue: that draws.
        speaker: bundle; None is the one that ships.
    """

    def __init__(self, queue: Queue, speaker: Path | None) -> None:
        self.queue, self.speaker = queue, speaker

    def blocks(self) -> Any:
        """The page, as Gradio's blocks."""
        from angie.bundle import PHOTO, SPEECH

        quiet: dict[str, Any] = {"api_visibility": "private", "show_progress": "hidden"}
        kept = round(self.queue.limits.kept)
        with gr.Blocks(
            title="angie", analytics_enabled=False, delete_cache=(min(600, kept), kept)
        ) as page:
            gr.Markdown(
                "# angie\nOne photo of a person and a recording of speech go in; a video of that "
                "person gesturing comes out. Everything stays on this machine."
            )
            with gr.Row():
                with gr.Column(min_width=300):
                    photo = gr.Image(
                        label="Photo", type="filepath", image_mode=None, height=260,
                        sources=["upload", "webcam", "clipboard"], elem_id="photo",
                    )  # fmt: skip
                    audio = gr.Audio(
                        label="Voice", type="filepath", sources=["upload", "microphone"],
                        elem_id="voice",
                    )  # fmt: skip
                    gr.Examples([[str(PHOTO), str(SPEECH)]], [photo, audio], label="Example")
                    square = self._square(photo, quiet)
                    options = self._options()
                    consent = gr.Checkbox(label=AGREED, elem_id="consent")
                    with gr.Row():
                        draw = gr.Button("Animate", variant="primary", elem_id="animate")
                        stop = gr.Button("Stop", variant="stop", elem_id="stop")
                with gr.Column(min_width=300):
                    status = gr.HTML(_told("Give a photo and a voice."), elem_id="status")
                    first = gr.Image(
                        label="First frames", interactive=False, height=280, elem_id="first",
                        buttons=[],
                    )  # fmt: skip
                    with gr.Row():
                        one = gr.Video(label="Video", interactive=False, elem_id="video")
                        two = gr.Video(label="Another seed", interactive=False, elem_id="other")
                    again = gr.Button("The same with another seed, beside it", elem_id="again")
                    plot = gr.Plot(label="Sound, beats, speed of hands, codes", elem_id="plot")
            inputs = [photo, audio, consent, *square, *options]
            turn = gr.State(0)
            draw.click(self.animate, inputs, [status, first, one, two, plot, turn],
                       trigger_mode="once", **quiet)  # fmt: skip
            again.click(self.again, [turn, *inputs], [status, first, two, plot, turn],
                        trigger_mode="once", **quiet)  # fmt: skip
            stop.click(self.stop, None, None, queue=False, **quiet)
            page.unload(self.leave)
            gr.Markdown(
                f"angie {__version__}. Every video says in its metadata that it is synthetic; "
                "`angie info` reads it."
            )
        page.queue(default_concurrency_limit=32)
        return page

    def _square(self, photo: Any, quiet: dict[str, Any]) -> list[Any]:
        """Where the photo moves: shown, moved by a click or by numbers."""
        shown = gr.Image(label="The square that moves; click to put it elsewhere",
                         interactive=False, elem_id="square", buttons=[])  # fmt: skip
        note = gr.HTML("", elem_id="square-note")
        with gr.Accordion("Square in numbers", open=False):
            x = gr.Slider(-1000, 4000, 0, step=1, label="left, in pixels of the photo")
            y = gr.Slider(-1000, 4000, 0, step=1, label="top")
            size = gr.Slider(SMALLEST, 4000, 256, step=1, label="side")
        numbers = [x, y, size]

        def find(path: str | None) -> Any:
            if not path:
                return None, "", *(gr.skip() for _ in numbers)
            try:
                crop, (width, height), words = found_square(Path(path))
            except BadInput as error:
                return None, _alert(_plain(error, path)), *(gr.skip() for _ in numbers)
            most = max(width, height)
            return (
                with_square(Path(path), crop), _told(words),
                gr.update(value=crop.x, minimum=-most, maximum=most),
                gr.update(value=crop.y, minimum=-most, maximum=most),
                gr.update(value=crop.size, maximum=max(2 * most, crop.size)),
            )  # fmt: skip

        def redraw(path: str | None, *square: float) -> Any:
            return with_square(Path(path), _crop(square)) if path else None

        def click(event: gr.SelectData, path: str | None, *square: float) -> Any:
            if not path:
                return None, *square
            with Image.open(path) as image:
                turned = image.getexif().get(274, 1) in (5, 6, 7, 8)
                size = image.size[::-1] if turned else image.size
            crop = moved_square(_crop(square), tuple(event.index), size)
            return with_square(Path(path), crop), crop.x, crop.y, crop.size

        photo.change(find, photo, [shown, note, *numbers], **quiet)
        for number in numbers:
            number.release(redraw, [photo, *numbers], shown, **quiet)
        shown.select(click, [photo, *numbers], [shown, *numbers], **quiet)
        return numbers

    def _options(self) -> list[Any]:
        """What else can be asked: `NAMES`, in their order."""
        from angie.bundle import BUNDLE, Bundle
        from angie.style import styles

        bundle = Bundle.open(self.speaker or BUNDLE)
        known = [name for name in bundle.generators if bundle.parts_of(name)]
        names = list(styles(bundle, bundle.chosen())) if known else []
        with gr.Accordion("Options", open=False):
            generator = gr.Dropdown(known, value=bundle.chosen(), label="Generator")
            style = gr.Dropdown(
                [("anyone's", ""), *((name, name) for name in names)], value="", label="Style"
            )
            seed = gr.Number(0, precision=0, minimum=0, maximum=2**31 - 2, label="Seed")
            temperature = gr.Slider(
                0.2, 2, 1, step=0.05, label="Temperature: how daring the gestures are"
            )
            amplitude = gr.Slider(0, 2, 1, step=0.05, label="Amplitude: how far the gestures go")
            fade = gr.Slider(0, 3, 0, step=0.25, label="Seconds to come to rest at the end")
            start = gr.Radio(["photo", "rest"], value="photo", label="Begins with the pose of")
            size = gr.Radio(["256", "512", "1024"], value="256", label="Pixels")
            words = gr.File(label="Transcript, for generators that read words", type="filepath")
        return [generator, style, seed, temperature, amplitude, fade, start, size, words]

    def animate(self, who: gr.Request, *given: Any) -> Iterator[tuple[Any, ...]]:
        """Draw a video; yields status, picture, video, nothing for the other one, plot and seed."""
        for words, picture, video, plot in self._draw(given, who, 0):
            yield words, picture, video, None, plot, 0

    def again(self, who: gr.Request, turn: int, *given: Any) -> Iterator[tuple[Any, ...]]:
        """Draw it with the next seed, beside the first one."""
        for words, picture, video, plot in self._draw(given, who, turn + 1):
            yield words, picture, video, plot, turn + 1

    def _draw(self, given: tuple[Any, ...], who: Any, more: int) -> Iterator[tuple[Any, ...]]:
        """Status, last picture, video and plot, again and again until it is done."""
        try:
            job = self._submit(given, str(who.session_hash), more)
        except (BadInput, Busy) as error:
            yield _alert(str(error)), None, gr.skip(), gr.skip()
            return
        try:
            while not job.ended.wait(WAIT):
                yield self.words(job), job.picture, gr.skip(), gr.skip()
            if job.state == DONE:
                yield self.words(job), None, str(job.video), job.extra
            else:
                yield self.words(job), None, gr.skip(), gr.skip()
        finally:  # the page has its own copy by now, or nobody listens any more
            self.queue.forget(job)

    def _submit(self, given: tuple[Any, ...], owner: str, more: int) -> Job:
        photo, audio, agreed, *square = given[:6]
        generator, style, seed, temperature, amplitude, fade, start, size, words = given[6:]
        if not photo or not audio:
            raise BadInput(f"Give a {'voice' if photo else 'photo'} first.")
        if not agreed:
            raise BadInput("Tick the box above the button: the person in the photo agreed.")
        folder = self.queue.folder()
        files = {"photo": photo, "audio": audio} | ({"words": words} if words else {})
        kept = {name: folder / f"{name}{Path(path).suffix[:12]}" for name, path in files.items()}
        for name, path in files.items():
            shutil.copyfile(path, kept[name])
        crop = _crop(square)
        request = Request(
            kept["photo"], kept["audio"], words=kept.get("words"), speaker=self.speaker,
            generator=generator or None, style=style or None, seed=int(seed or 0) + more,
            temperature=None if temperature == 1 else temperature, fade=fade,
            amplitude=amplitude, start=start,
            crop=f"{crop.x},{crop.y},{crop.size}", size=size, consent=AGREED,
        )  # fmt: skip
        return self.queue.submit(request, folder, owner, after=_curves)

    def stop(self, who: gr.Request) -> None:
        """Stop what this tab asked for."""
        for job in self.queue.of(str(who.session_hash)):
            self.queue.cancel(job)

    def leave(self, who: gr.Request) -> None:
        """Let go of all that a tab asked for, which was closed."""
        self.queue.drop(str(who.session_hash))

    def words(self, job: Job) -> str:
        """How far a job is, as HTML that a screen reader reads."""
        if job.state == DONE:
            note = f" Note: {job.message}." if job.message else ""
            return _told(f"Done: {job.frames} frames.{note}")
        if job.state == FAILED:
            return _alert(job.message)
        if job.state == CANCELLED or job.stop:
            return _told("Stopped.")
        if job.state == RUNNING and job.share:
            left = job.seconds_left
            time = "" if left is None else f", about {left:.0f} s left"
            bar = f'<progress max="1" value="{job.share:.3f}" aria-label="drawn"></progress>'
            return _told(f"Drawing: {job.share:.0%}{time}") + bar
        if job.state == RUNNING:
            what = {"sound": "Listening", "gestures": "Finding gestures"}
            label = "" if job.step is None else job.step.label
            return _told(f"{what.get(label, 'Looking at the photo')} ...") + "<progress></progress>"
        return _told(f"Waiting: {self.queue.ahead(job)} before this one.")


def _curves(video: "GestureVideo", pipeline: "GesturePipeline") -> Any:
    """The plot below a video."""
    from angie.preview import curves, figure_of

    return figure_of(curves(video, pipeline))


def _crop(square: Any) -> Crop:
    x, y, size = (round(value) for value in square)
    return Crop(x, y, size)


def _plain(error: BadInput, path: str) -> str:
    return str(error).replace(f"{Path(path).parent}/", "")


def _told(text: str) -> str:
    return f'<div role="status">{escape(text)}</div>'


def _alert(text: str) -> str:
    return f'<div role="alert">{escape(text)}</div>'
