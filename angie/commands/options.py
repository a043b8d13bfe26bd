"""What the commands share: options of one meaning everywhere, and reading what was typed."""

from pathlib import Path
from typing import Annotated

import typer

from angie.request import cores, device_of, square_of
from data_prep.files import want_file

__all__ = ["cores", "device_of", "square_of", "want_file"]

Force = Annotated[bool, typer.Option("--force", help="Replace an existing output.")]
Seed = Annotated[int, typer.Option(min=0, max=2**31 - 1, help="Seed of everything random.")]
Device = Annotated[str, typer.Option(help="auto, cpu, cuda or mps.")]
Precision = Annotated[
    str, typer.Option(help="Of the networks: auto (the fastest available), fp32, bf16 or fp16.")
]
Style = Annotated[
    str | None,
    typer.Option(
        help="Take this training speaker's way of gesturing, but not their rest pose; for models "
        "of several speakers, whom angie info lists. Where there is a style space, also a mixture, "
        "A:0.3,B:0.7, or a point of it, numbers separated by commas."
    ),
]
Words = Annotated[
    Path | None,
    typer.Option(
        help="Transcript of AUDIO, of any format that prepare reads, or plain text; for generators "
        "that read words."
    ),
]
Generator = Annotated[
    str | None,
    typer.Option("--generator", help="Which generator of the bundle; without it angie's."),
]
Format = Annotated[
    str | None,
    typer.Option(
        help="mp4, webm, gif (no sound) or frames (a folder of PNG files).",
        show_default="as the name ends",
    ),
]
Ray = Annotated[
    str | None,
    typer.Option(
        help="Address of a Ray cluster to work on, auto for this machine's, local to begin one."
    ),
]
Consent = Annotated[
    str, typer.Option(help="How the person of the photo agreed; kept in the video's metadata.")
]
Size = Annotated[
    str | None,
    typer.Option(
        help="Pixels of the video's side: 256, 512, 1024, or photo for the square's own.",
        show_default="256",
    ),
]
FullFrame = Annotated[
    bool, typer.Option("--full-frame", help="Show the whole photo, not only the square.")
]
Greedy = Annotated[
    bool,
    typer.Option(
        "--greedy",
        help="Always the likeliest gesture, whatever the seed; without it gestures are sampled, "
        "whatever the bundle's settings say.",
    ),
]
Person = Annotated[
    str | None, typer.Option(help="Which of several people: left, right or largest.")
]
Settings = Annotated[
    list[str] | None, typer.Argument(help="key=value, or YAML files with settings.")
]
Seeds = Annotated[int, typer.Option(min=1, max=100, help="Number of random seeds.")]
NoImages = Annotated[bool, typer.Option("--no-images", help="Render nothing: motion scores only.")]
ImageStride = Annotated[
    int, typer.Option(min=2, help="Render two frames every so many frames for image scores.")
]
ImageSeconds = Annotated[
    float,
    typer.Option(min=0, help="Score only pictures of the first seconds of each clip; 0 for all."),
]
Fgd = Annotated[
    Path | None, typer.Option(help="Autoencoder of an earlier report, to compare with it.")
]
FgdSteps = Annotated[int, typer.Option(min=1, help="Maximum training steps of FGD's autoencoder.")]
Models = Annotated[
    Path | None,
    typer.Option(help="Folder of MediaPipe's networks; the one for faces finds them faster."),
]
Jobs = Annotated[int, typer.Option(min=0, help="Number of processes; 0 for one per core.")]
