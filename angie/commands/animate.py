"""Commands that make videos: animate, demo.

Commands of the motion side: gestures, codebook, ablate.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from angie.commands.options import (
    Device,
    Fgd,
    FgdSteps,
    Force,
    FullFrame,
    Generator,
    Greedy,
    ImageSeconds,
    ImageStride,
    Models,
    NoImages,
    Person,
    Precision,
    Seed,
    Seeds,
    Settings,
    Size,
    Style,
    Words,
    device_of,
    square_of,
    want_file,
)
from data_prep.errors import BadInput, check_choice, collected_notes, note
from data_prep.progress import begin, console
from data_prep.rates import FPS

if TYPE_CHECKING:
    from data_prep.speaker.crop import Crop
    from data_prep.speech.features import Speech


def animate(
    photo: Annotated[Path, typer.Argument(help="Any photo of a person.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The mp4 to write.")],
    audio: Annotated[
        Path | None, typer.Argument(help="Any recording, or a video with sound.")
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
    track_axes: Annotated[
        bool, typer.Option("--track-axes", help="Follow the regions' axes over time; not in MRAA.")
    ] = False,
    force: Force = False,
) -> None:
    """Make the person of a photo gesture to a recording, or as in a driving video."""
    from angie.generators import DEFAULT
    from data_prep.files import check_apart, check_mp4, check_output

    check_output(output, force=force)
    check_mp4(output)
    want_file(photo, "photo")
    if audio is not None:
        want_file(audio, "recording")
    if words is not None:
        want_file(words, "transcript")
    check_choice("--scale-motion", scale_motion, ("none", "hull"))
    given = None if crop is None else square_of(crop)
    usual = generator in (None, DEFAULT) and words is None
    heard = begin(_heard, audio) if usual and audio is not None and drive is None else None
    square = _found(photo, person, models) if given is None else lambda: given
    look: dict[str, Any] = {
        "person": person, "models": models, "size": size, "full_frame": full_frame,
        "track_axes": track_axes,
    }  # fmt: skip
    inputs = [path for path in (photo, audio, drive, words) if path is not None]
    check_apart(output, inputs)
    if drive is not None:
        want_file(drive, "driving video")
        sound_only = (style, generator, words)
        changed = greedy or scale_motion != "none" or amplitude != 1
        if changed or any(given is not None for given in sound_only):
            raise BadInput(
                "--greedy, --style, --words, --scale-motion, --amplitude and --generator are for "
                "gestures to sound, not for --drive"
            )
    elif audio is None:
        raise BadInput("give a recording to gesture to, or a video to follow with --drive VIDEO")
    elif mode or drive_crop or drive_person:
        raise BadInput("--mode, --drive-crop and --drive-person go with --drive VIDEO")
    from angie.bundle import BUNDLE, Bundle
    from angie.pipeline import GesturePipeline
    from angie.source import View

    pipeline = GesturePipeline(
        Bundle.open(speaker or BUNDLE), generator, device=device_of(device), precision=precision
    )
    view = View(crop=square(), **look)
    if drive is not None:
        from angie.drive import Driving
        from angie.drive import drive as from_video

        corner = None if drive_crop is None else square_of(drive_crop, "--drive-crop")
        driving = Driving(mode, audio, corner, drive_person)
        result = from_video(pipeline, photo, drive, driving, view)
    else:
        assert audio is not None
        _ = pipeline.generator, pipeline.renderer  # loaded while the recording is listened to
        result = pipeline(
            photo,
            audio,
            seed=seed,
            style=style,
            greedy=greedy,
            scale_motion=scale_motion,
            amplitude=amplitude,
            view=view,
            speech=_noted(*heard()) if heard else None,
            words=words,
        )
    result.save(output, force=force)
    if result.note:
        console.print(f"angie: {result.note}", highlight=False, markup=False, soft_wrap=True)
    width, height = result.width_height
    sound = f"{result.seconds:.2f} s of sound" if result.seconds else "no sound"
    print(f"{output}: {result.frames} frames of {width}x{height}, {sound}")


def _heard(audio: Path) -> "tuple[Speech, list[str]]":
    """The features of a recording that the default generator reads, and what was odd about it.

    In a process of its own: Librosa is imported beside the networks' libraries, not after them.
    """
    from angie.generators import DEFAULT_FEATURES
    from data_prep.media.audio import read_sound
    from data_prep.speech.features import Speech

    with collected_notes() as notes:
        speech = Speech(read_sound(audio))
        for name in DEFAULT_FEATURES:
            speech[name]
    speech.forget_samples()
    return speech, notes


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

    animate(
        PHOTO,
        output,
        SPEECH,
        generator=generator,
        words=None if generator in (None, DEFAULT) else WORDS,
        seed=seed,
        device=device,
        precision=precision,
        force=force,
    )


def gestures(
    bundle: Annotated[Path, typer.Argument(help="Bundle of joints or of regions.")],
    audio: Annotated[Path, typer.Argument(help="Any recording, or a video with sound.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The .npz or .npy to write.")],
    start: Annotated[
        Path | None, typer.Option(help="Motion file whose first frame is the start pose.")
    ] = None,
    speaker: Annotated[
        str | None,
        typer.Option(
            help="The training speaker who gestures, the first one if none is named: their rest "
            "pose to begin with, unless --start gives another; if named, also to return to, and "
            "in joint models their style."
        ),
    ] = None,
    style: Style = None,
    words: Words = None,
    generator: Generator = None,
    fps: Annotated[float, typer.Option(min=1, max=1000, help="Frames per second of joints.")] = FPS,
    seed: Seed = 0,
    greedy: Greedy = False,
    force: Force = False,
) -> None:
    """Write the motion for a recording as arrays: joints (T, J, 2), or regions."""
    from data_prep.files import check_output

    check_output(output, force=force)
    want_file(audio, "recording")
    if start is not None:
        want_file(start, "motion to begin with")
    if words is not None:
        want_file(words, "transcript")
    from angie.bundle import Bundle
    from angie.gestures import gestures as make
    from angie.pipeline import GesturePipeline

    frames = make(
        GesturePipeline(Bundle.open(bundle), generator, precision="fp32"),
        audio,
        output,
        start=start,
        speaker=speaker,
        style=style,
        words=words,
        fps=fps,
        seed=seed,
        greedy=greedy,
        force=force,
    )
    print(f"{output}: {frames} frames at {fps:g} a second")


def codebook(
    bundle: Annotated[Path, typer.Argument(help="Speaker bundle.")],
    photos: Annotated[list[Path], typer.Argument(help="Photos of people.")],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="The .png to write, and an .mp4 beside it.")
    ],
    codes: Annotated[
        int, typer.Option(min=1, max=24, help="Number of pairs of codes, one per row.")
    ] = 6,
    generator: Generator = None,
    person: Person = None,
    force: Force = False,
) -> None:
    """Show codes of the motion codebooks on photos, and how much each is used."""
    for photo in photos:
        want_file(photo, "photo")
    from angie.bundle import Bundle
    from angie.generators import family

    opened = Bundle.open(bundle)
    found = family(opened.chosen(generator))
    if found.codes_shown is None:
        raise BadInput(f"--generator {found.name}: has no codes to show")
    print(found.codes_shown(opened, photos, output, count=codes, person=person, force=force))


def ablate(
    dataset: Annotated[Path, typer.Argument(help="Folder that angie prepare made.")],
    bundle: Annotated[
        Path, typer.Argument(help="Bundle whose renderer and settings all variants share.")
    ],
    settings: Settings = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder of bundles, report and table.")
    ] = None,
    variants: Annotated[
        str | None, typer.Option(help="Some of the variants, separated by commas; all by default.")
    ] = None,
    generator: Generator = None,
    seeds: Seeds = 1,
    trainings: Annotated[
        int,
        typer.Option(min=1, help="Seeds to train the variants with that the comparison stands on."),
    ] = 1,
    no_images: NoImages = False,
    image_stride: ImageStride = 25,
    image_seconds: ImageSeconds = 0.0,
    fgd: Fgd = None,
    fgd_steps: FgdSteps = 3000,
    seed: Seed = 0,
    device: Device = "auto",
) -> None:
    """Train and score the variants of a paper's ablations; repeat it to continue a killed run."""
    if output is None:
        raise BadInput("--output: name the folder of the ablations, -o DIR")
    if fgd is not None:
        want_file(fgd, "autoencoder of a report")
    from angie.config import parse_overrides
    from angie.evaluation.ablation import ablate as run
    from angie.evaluation.networks import EvaluationConfig
    from mraa.training.run import RunConfig

    place = device_of(device)
    chosen = None if variants is None else [name.strip() for name in variants.split(",")]
    scoring = EvaluationConfig(
        seeds=seeds,
        seed=seed,
        images=not no_images,
        image_stride=image_stride,
        image_seconds=image_seconds,
        videos_shown=0,
        fgd=fgd,
        fgd_steps=fgd_steps,
    )
    text = run(
        dataset,
        bundle,
        output,
        variants=chosen,
        generator=generator,
        changes=parse_overrides(settings or []),
        config=scoring,
        trainings=trainings,
        seed=seed,
        run=RunConfig(device=device),
        device=place,
    )
    print(text)
    print(f"{output}: table3.md, report, a bundle for each row")
