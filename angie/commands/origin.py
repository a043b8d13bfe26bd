"""The command that checks where a video comes from: verify."""

from pathlib import Path
from typing import Annotated

import typer

from angie.commands.options import Device, Precision, want_file
from angie.request import Pipelines, Request


def verify(
    video: Annotated[Path, typer.Argument(help="A video that angie wrote.")],
    photo: Annotated[Path, typer.Option(help="The photo that it was made from.")],
    audio: Annotated[Path | None, typer.Option(help="The recording that it was made from.")] = None,
    drive: Annotated[Path | None, typer.Option(help="The driving video, if there was one.")] = None,
    motion: Annotated[Path | None, typer.Option(help="The saved motion, if there was one.")] = None,
    words: Annotated[Path | None, typer.Option(help="The transcript, if there was one.")] = None,
    speaker: Annotated[
        Path | None, typer.Option(help="Speaker bundle; the shipped one by default.")
    ] = None,
    device: Device = "auto",
    precision: Precision = "auto",
) -> None:
    """Draw a video again from what it was made of, and say whether it is that video.

    Exit status 0 if it is, 1 if it is not.
    """
    from angie.provenance import read_origin

    for path, what in ((photo, "photo"), (audio, "recording"), (drive, "driving video"),
                       (motion, "saved motion"), (words, "transcript")):  # fmt: skip
        if path is not None:
            want_file(path, what)
    origin = read_origin(video)
    from angie.verify import verify as check

    request = Request(photo, speaker=speaker, generator=origin.generator or None)
    pipeline = Pipelines(device, precision).of(request)
    verdict = check(video, pipeline, photo, audio, drive=drive, motion=motion, words=words)
    print(f"{video}: {verdict}")
    if not verdict.same:
        raise typer.Exit(1)
