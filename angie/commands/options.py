"""What the commands share: options of one meaning everywhere, and reading what was typed."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from data_prep.errors import BadInput

if TYPE_CHECKING:
    from data_prep.speaker.crop import Crop

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


def want_file(path: Path, what: str) -> None:
    """Refuse a path that is no file; `what` it should be is told.

    Raises:
        BadInput: missing, or a folder.
    """
    if not path.exists():
        raise BadInput(f"{path}: no such file; give the {what}")
    if path.is_dir():
        raise BadInput(f"{path}: is a folder; give the {what}")


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
