"""Commands that make videos: animate, demo."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from angie.commands.options import (
    Consent,
    Device,
    Force,
    Format,
    FullFrame,
    Generator,
    Greedy,
    Models,
    Person,
    Precision,
    Ray,
    Seed,
    Size,
    Style,
    Words,
)
from angie.request import OPTIONS, Pipelines, Request
from data_prep.errors import BadInput, note
from data_prep.processes import begin
from data_prep.progress import console
from data_prep.speech.hearing import hear

if TYPE_CHECKING:
    from data_prep.speaker.crop import Crop
    from data_prep.speech.features import Speech


def animate(
    photo: Annotated[Path | None, typer.Argument(help="Any photo of a person.")] = None,
    audio: Annotated[
        Path | None, typer.Argument(help="Any recording, or a video with sound.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="The mp4, webm or gif to write.")
    ] = None,
    speaker: Annotated[
        Path | None, typer.Option(help="Speaker bundle; the shipped one by default.")
    ] = None,
    generator: Generator = None,
    seed: Seed = 0,
    device: Device = "auto",
    crop: Annotated[
        str | None, typer.Option(help="Square of the photo: x,y,size in pixels.")
    ] = None,
    person: Person = None,
    scale_motion: Annotated[
        str, typer.Option(help="hull scales gestures to the person's size; or none.")
    ] = "none",
    amplitude: Annotated[
        float,
        typer.Option(
            min=0, max=2, help="How far the gestures go from the photo's pose; 1 is as made."
        ),
    ] = 1.0,
    temperature: Annotated[
        float | None,
        typer.Option(help="How daring the gestures are, above 0 and up to 5; 1 is as trained."),
    ] = None,
    start: Annotated[
        str, typer.Option(help="Begin with the photo's pose (photo) or a speaker's at rest (rest).")
    ] = "photo",
    fade: Annotated[
        float, typer.Option(min=0, help="Seconds at the end in which the person comes to rest.")
    ] = 0.0,
    greedy: Greedy = False,
    style: Style = None,
    words: Words = None,
    precision: Precision = "auto",
    size: Size = None,
    full_frame: FullFrame = False,
    drive: Annotated[
        Path | None,
        typer.Option(help="Take the motion from this video, and its sound if AUDIO is not given."),
    ] = None,
    mode: Annotated[
        str | None,
        typer.Option(
            help="With --drive: standard, relative or avd (the default where the bundle has it)."
        ),
    ] = None,
    drive_crop: Annotated[
        str | None, typer.Option(help="Square of the driving video: x,y,size in pixels.")
    ] = None,
    drive_person: Annotated[
        str | None, typer.Option(help="Which of several people in it: left, right or largest.")
    ] = None,
    models: Models = None,
    motion: Annotated[
        Path | None, typer.Option(help="Draw this saved motion; AUDIO only sounds with it.")
    ] = None,
    save_motion: Annotated[
        Path | None, typer.Option(help="Write the motion too, as .npz for --motion.")
    ] = None,
    track_axes: Annotated[
        bool, typer.Option("--track-axes", help="Follow the regions' axes over time; not in MRAA.")
    ] = False,
    format: Format = None,
    preview: Annotated[
        bool,
        typer.Option(
            "--preview",
            help="Write a sheet in place of the video: frames with regions, onsets and speed.",
        ),
    ] = False,
    consent: Consent = "",
    jobs: Annotated[
        Path | None,
        typer.Option(
            help="A .csv of videos to make: columns photo, audio, output and any option by name."
        ),
    ] = None,
    ray: Ray = None,
    force: Force = False,
) -> None:
    """Make the person of a photo gesture to a recording, or as in a driving video.

    With --jobs many videos are made; repeated, the command goes on where it was stopped.
    """
    options: dict[str, Any] = {
        "speaker": speaker, "generator": generator, "seed": seed, "crop": crop, "person": person,
        "models": models,
        "scale_motion": scale_motion, "amplitude": amplitude, "temperature": temperature,
        "start": start, "fade": fade,
        "greedy": greedy, "style": style, "words": words, "size": size, "full_frame": full_frame,
        "drive": drive, "mode": mode, "drive_crop": drive_crop, "drive_person": drive_person,
        "motion": motion, "track_axes": track_axes, "format": format, "consent": consent,
    }  # fmt: skip
    if jobs is not None:
        if photo or audio or output or save_motion or preview:
            raise BadInput("--jobs: the list names photos, recordings and outputs; give none here")
        _list_of_jobs(jobs, options, Pipelines(device, precision), force, ray)
        return
    if ray is not None:
        raise BadInput(f"--ray {ray}: is for many videos; give a list with --jobs")
    if photo is None or output is None:
        missing = "argument 'PHOTO'" if photo is None else "option '--output' / '-o'"
        raise BadInput(f"missing {missing} (see angie animate --help)")
    request = Request(photo, audio, **options)
    _animate(request, output, Pipelines(device, precision), save_motion, preview, force)


def _animate(
    request: Request,
    output: Path,
    pipelines: Pipelines,
    save_motion: Path | None,
    preview: bool,
    force: bool,
) -> None:
    """Make one video, or the sheet that stands for it."""
    from angie.generators import DEFAULT, DEFAULT_FEATURES
    from data_prep.files import check_apart, check_output
    from data_prep.media.formats import format_of

    outputs = [output, *([save_motion] if save_motion else [])]
    for path in outputs:
        check_output(path, force=force)
    if preview and (output.suffix.lower() != ".png" or request.format is not None):
        raise BadInput(f"{output}: --preview writes a picture; let its name end in .png")
    if not preview:
        format_of(output, request.format)
    request.check()
    spoken = request.audio is not None and request.drive is None and request.motion is None
    usual = request.generator in (None, DEFAULT) and request.words is None
    heard = None
    if usual and spoken and request.audio:
        heard = begin(hear, (request.audio, DEFAULT_FEATURES))
    square = None if request.crop else _found(request.photo, request.person, request.models)
    for path in outputs:
        check_apart(path, request.inputs)
    pipeline = pipelines.of(request)
    if spoken:
        _ = pipeline.generator, pipeline.renderer  # loaded while the recording is listened to
    result = request.make(
        pipeline, crop=square() if square else None, speech=_noted(*heard()) if heard else None
    )
    if save_motion is not None:
        result.save_motion(save_motion, force=force)
    if preview:
        from angie.preview import write_sheet

        print(write_sheet(result, pipeline, output, force=force))
        return
    result.save(output, force=force, format=request.format, consent=request.consent)
    if result.note:
        console.print(f"angie: {result.note}", highlight=False, markup=False, soft_wrap=True)
    width, height = result.width_height
    sounds = format_of(output, request.format) in ("mp4", "webm") and result.seconds > 0
    sound = f"{result.seconds:.2f} s of sound" if sounds else "no sound"
    print(f"{output}: {result.frames} frames of {width}x{height}, {sound}")


def _list_of_jobs(
    jobs: Path, options: dict[str, Any], pipelines: Pipelines, force: bool, ray: str | None
) -> None:
    """Make the videos of a list; exit status 1 if some could not be made."""
    from angie.batch import run

    usual = {name: value for name, value in options.items() if value != OPTIONS[name]}
    failed = run(jobs, pipelines, usual, force=force, ray=ray)
    if failed:
        raise typer.Exit(1)


def _noted(speech: "Speech", notes: list[str]) -> "Speech":
    for text in notes:
        note(text)
    return speech


def _found(photo: Path, person: str | None, models: Path | None) -> Callable[[], "Crop | None"]:
    """Look for the person while the networks' libraries are imported; call it for the square."""
    from angie.source import find_crop

    with_libraries = ThreadPoolExecutor(1)
    found = with_libraries.submit(find_crop, photo, person, models)
    with_libraries.shutdown(wait=False)
    return found.result


def demo(
    output: Annotated[Path, typer.Option("--output", "-o", help="The mp4 to write.")] = Path(
        "angie-demo.mp4"
    ),
    generator: Generator = None,
    seed: Seed = 0,
    device: Device = "auto",
    precision: Precision = "auto",
    force: Force = False,
) -> None:
    """Animate the photo and the recording that ship with angie."""
    from angie.bundle import PHOTO, SPEECH, WORDS
    from angie.generators import DEFAULT

    words = None if generator in (None, DEFAULT) else WORDS
    request = Request(PHOTO, SPEECH, seed=seed, generator=generator, words=words)
    _animate(request, output, Pipelines(device, precision), None, False, force)
