"""Commands that make videos: animate, demo."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from angie.commands.options import (
    Device,
    Force,
    FullFrame,
    Precision,
    Seed,
    Size,
    Style,
    device_of,
    square_of,
    want_file,
)
from data_prep.errors import BadInput
from data_prep.progress import console

if TYPE_CHECKING:
    from data_prep.speaker import Crop


def animate(
    photo: Annotated[Path, typer.Argument(help="Any photo of a person.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The mp4 to write.")],
    audio: Annotated[
        Path | None, typer.Argument(help="Any recording, or a video with sound.")
    ] = None,
    speaker: Annotated[
        Path | None, typer.Option(help="Speaker bundle; without it the shipped one.")
    ] = None,
    seed: Seed = 0,
    device: Device = "auto",
    crop: Annotated[
        str | None, typer.Option(help="Square of the photo: x,y,size in pixels.")
    ] = None,
    person: Annotated[
        str | None, typer.Option(help="Of several people: left, right or largest.")
    ] = None,
    scale_motion: Annotated[
        str, typer.Option(help="none, or hull: scale gestures to the person's size.")
    ] = "none",
    greedy: Annotated[
        bool,
        typer.Option(
            "--greedy",
            help="Always the likeliest gesture, whatever the seed; without it gestures are "
            "sampled, whatever generation.sampling.method the bundle has.",
        ),
    ] = False,
    style: Style = None,
    precision: Precision = "auto",
    size: Size = None,
    full_frame: FullFrame = False,
    drive: Annotated[
        Path | None,
        typer.Option(help="Take the motion from this video, and without AUDIO its sound."),
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
        str | None, typer.Option(help="Of several people in it: left, right or largest.")
    ] = None,
    track_axes: Annotated[
        bool, typer.Option("--track-axes", help="Follow the axes of regions; not in MRAA.")
    ] = False,
    force: Force = False,
) -> None:
    """Make the person of a photo gesture to a recording, or as in a driving video."""
    from data_prep.output import check_output

    check_output(output, force=force)
    if output.suffix.lower() != ".mp4":
        raise BadInput(f"{output}: the video is an mp4; let its name end in .mp4")
    want_file(photo, "photo")
    if audio is not None:
        want_file(audio, "recording")
    if scale_motion not in ("none", "hull"):
        raise BadInput(f"--scale-motion {scale_motion}: there are none and hull")
    given = None if crop is None else square_of(crop)
    square = _found(photo, person) if given is None else lambda: given
    from angie.bundle import Bundle
    from angie.demo import BUNDLE

    bundle = Bundle.open(speaker or BUNDLE)
    look: dict[str, Any] = {
        "device": device_of(device),
        "person": person,
        "precision": precision,
        "size": size,
        "full_frame": full_frame,
        "track_axes": track_axes,
        "force": force,
    }
    if drive is not None:
        want_file(drive, "driving video")
        from angie.drive import drive as from_video

        if greedy or scale_motion != "none" or style is not None:
            raise BadInput(
                "--greedy, --style and --scale-motion are for gestures to sound, not for --drive"
            )
        corner = None if drive_crop is None else square_of(drive_crop, "--drive-crop")
        result = from_video(
            photo,
            drive,
            output,
            bundle,
            mode=mode,
            sound_path=audio,
            drive_crop=corner,
            drive_person=drive_person,
            crop=square(),
            **look,
        )
    elif audio is None:
        raise BadInput("give a recording to gesture to, or a video to follow with --drive VIDEO")
    elif mode or drive_crop or drive_person:
        raise BadInput("--mode, --drive-crop and --drive-person go with --drive VIDEO")
    else:
        from angie.animate import animate as from_sound

        result = from_sound(
            photo,
            audio,
            output,
            bundle,
            seed=seed,
            scale_motion=scale_motion,
            greedy=greedy,
            style=style,
            crop=square(),
            **look,
        )
    if result.note:
        console.print(f"angie: {result.note}", highlight=False, markup=False, soft_wrap=True)
    width, height = result.width_height
    sound = f"{result.seconds:.2f} s of sound" if result.seconds else "no sound"
    print(f"{result.path}: {result.frames} frames of {width}x{height}, {sound}")


def _found(photo: Path, person: str | None) -> Callable[[], "Crop | None"]:
    """Look for the person while the networks' libraries are imported; call it for the square."""
    from angie.photo_crop import find_crop

    with_libraries = ThreadPoolExecutor(1)
    found = with_libraries.submit(find_crop, photo, person)
    with_libraries.shutdown(wait=False)
    return found.result


def demo(
    output: Annotated[Path, typer.Option("--output", "-o", help="The mp4 to write.")] = Path(
        "angie-demo.mp4"
    ),
    seed: Seed = 0,
    device: Device = "auto",
    precision: Precision = "auto",
    force: Force = False,
) -> None:
    """Animate the photo and the recording that ship."""
    from angie.demo import PHOTO, SPEECH

    animate(PHOTO, output, SPEECH, seed=seed, device=device, precision=precision, force=force)
