"""Commands that make videos: animate, demo."""

from pathlib import Path
from typing import Annotated

import typer

from angie.commands.options import (
    Device,
    Force,
    FullFrame,
    Precision,
    Seed,
    Size,
    device_of,
    square_of,
    want_file,
)
from data_prep.errors import BadInput
from data_prep.progress import console


def animate(
    photo: Annotated[Path, typer.Argument(help="Any photo of a person.")],
    audio: Annotated[Path, typer.Argument(help="Any recording, or a video with sound.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The mp4 to write.")],
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
        bool, typer.Option("--greedy", help="Always the likeliest gesture, whatever the seed.")
    ] = False,
    precision: Precision = "auto",
    size: Size = None,
    full_frame: FullFrame = False,
    force: Force = False,
) -> None:
    """Make the person of a photo gesture to a recording."""
    from data_prep.output import check_output

    check_output(output, force=force)
    want_file(photo, "photo")
    want_file(audio, "recording")
    if scale_motion not in ("none", "hull"):
        raise BadInput(f"--scale-motion {scale_motion}: there are none and hull")
    square = None if crop is None else square_of(crop)
    from angie.animate import animate as make
    from angie.bundle import Bundle
    from angie.demo import BUNDLE

    result = make(
        photo,
        audio,
        output,
        Bundle.open(speaker or BUNDLE),
        seed=seed,
        device=device_of(device),
        crop=square,
        person=person,
        scale_motion=scale_motion,
        greedy=greedy,
        precision=precision,
        size=size,
        full_frame=full_frame,
        force=force,
    )
    if result.note:
        console.print(f"angie: {result.note}", highlight=False, markup=False, soft_wrap=True)
    width, height = result.width_height
    print(
        f"{result.path}: {result.frames} frames of {width}x{height}, "
        f"{result.seconds:.2f} s of sound"
    )


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

    animate(PHOTO, SPEECH, output, seed=seed, device=device, precision=precision, force=force)
