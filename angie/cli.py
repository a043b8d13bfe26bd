"""The `angie` command."""

import json
import os
import signal
import sys
from pathlib import Path
from typing import Annotated

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # spinning threads starve a shared machine

import typer  # noqa: E402

from angie import __version__
from data_prep.errors import BadInput
from data_prep.progress import console

app = typer.Typer(
    help="One photo of a speaker and a speech recording in, a video of that person gesturing out.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

Force = Annotated[bool, typer.Option("--force", help="Replace an existing output.")]
Seed = Annotated[int, typer.Option(min=0, max=2**31 - 1, help="Everything random follows from it.")]
Device = Annotated[str, typer.Option(help="auto, cpu, cuda or mps.")]
Jobs = Annotated[int, typer.Option(min=0, help="Processes; 0 for one a core.")]
# the modules behind a command are imported when it runs, so that `angie --help` is quick


@app.command()
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
    force: Force = False,
) -> None:
    """Make the person of a photo gesture to a recording."""
    from data_prep.output import check_output

    check_output(output, force=force)
    _want_file(photo, "photo")
    _want_file(audio, "recording")
    if scale_motion not in ("none", "hull"):
        raise BadInput(f"--scale-motion {scale_motion}: there are none and hull")
    square = None if crop is None else _square(crop)
    from angie.animate import animate as make
    from angie.bundle import Bundle
    from angie.demo import BUNDLE

    result = make(
        photo,
        audio,
        output,
        Bundle.open(speaker or BUNDLE),
        seed=seed,
        device=_device(device),
        crop=square,
        person=person,
        scale_motion=scale_motion,
        greedy=greedy,
        force=force,
    )
    print(f"{result.path}: {result.frames} frames, {result.seconds:.2f} s of sound")


@app.command()
def demo(
    output: Annotated[Path, typer.Option("--output", "-o", help="The mp4 to write.")] = Path(
        "angie-demo.mp4"
    ),
    seed: Seed = 0,
    device: Device = "auto",
    force: Force = False,
) -> None:
    """Animate the photo and the recording that ship."""
    from angie.demo import PHOTO, SPEECH

    animate(PHOTO, SPEECH, output, seed=seed, device=device, force=force)


@app.command()
def phantom(
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the videos.")],
    minutes: Annotated[
        float, typer.Option(min=0.1, max=6000, help="Length of all videos together.")
    ] = 4.0,
    presenters: Annotated[int, typer.Option(min=1, help="Number of presenters.")] = 4,
    seed: Seed = 0,
    voice: Annotated[
        str, typer.Option(help="auto (eSpeak NG where it is installed), builtin or espeak.")
    ] = "builtin",
    jobs: Jobs = 0,
    force: Force = False,
) -> None:
    """Write videos of the phantom speaker, and their truth."""
    from data_prep.output import whole_folder
    from data_prep.phantom.make import make_phantom

    with whole_folder(output, mark="phantom.json", force=force) as part:
        videos = make_phantom(
            part,
            minutes=minutes,
            seed=seed,
            presenters=presenters,
            jobs=jobs or _cores(),
            voice=voice,
        )
        origin = {"angie": __version__, "minutes": minutes, "presenters": presenters, "seed": seed,
                  "voice": voice}  # fmt: skip
        (part / "phantom.json").write_text(json.dumps(origin) + "\n")
    print(f"{output}: {len(videos)} videos of {presenters} presenters")


@app.command()
def prepare(
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder of the dataset.")],
    videos: Annotated[
        list[Path] | None, typer.Argument(help="Videos, or folders of videos.")
    ] = None,
    speaker: Annotated[
        str | None,
        typer.Option(help="Name of the speaker; without it the folder's. With --pats: whose."),
    ] = None,
    crop: Annotated[
        str | None, typer.Option(help="Square of the picture: x,y,size or x,y,w,h in pixels.")
    ] = None,
    person: Annotated[
        str | None, typer.Option(help="left, right or largest, where several people are seen.")
    ] = None,
    stabilize: Annotated[
        bool, typer.Option("--stabilize", help="Hold the picture still where the camera moves.")
    ] = False,
    silent_ok: Annotated[
        bool, typer.Option("--silent-ok", help="Keep videos without sound (renderer alone).")
    ] = False,
    shortest: Annotated[float, typer.Option(min=3.9, help="Seconds of the shortest clip.")] = 4.0,
    longest: Annotated[float, typer.Option(help="Seconds of the longest clip.")] = 14.0,
    pats: Annotated[
        Path | None, typer.Option(help="PATS' table of intervals; only these are cut.")
    ] = None,
    folder: Annotated[
        list[Path] | None, typer.Option("--videos", help="Folder with the videos of --pats.")
    ] = None,
    jobs: Jobs = 0,
    add: Annotated[
        bool, typer.Option("--add", help="Put other videos into the dataset that is there.")
    ] = False,
    force: Force = False,
) -> None:
    """Cut videos of a speaker into a dataset of clips.

    Repeated, the command goes on where it was killed, or makes what videos have come since.
    """
    from data_prep.outcome import IngestionConfig
    from data_prep.prepare import prepare as make

    places = [*(videos or []), *(folder or [])]
    if not places:
        raise BadInput("no video is named; give videos or folders of videos")
    if person not in (None, "left", "right", "largest"):
        raise BadInput(f"--person {person}: there are left, right and largest")
    if not 2 * shortest <= longest <= 60:
        raise BadInput(f"--longest {longest:g}: must be twice --shortest {shortest:g}, at most 60")
    if add and force:
        raise BadInput("--add and --force: give one; --add keeps the dataset, --force replaces it")
    config = IngestionConfig(
        crop=None if crop is None else _square(crop),
        person=person,
        stabilize=stabilize,
        silent_ok=silent_ok,
        shortest=shortest,
        longest=longest,
    )
    cores = jobs or _cores()
    print(
        make(
            places,
            output,
            speaker=speaker,
            jobs=cores,
            config=config,
            pats=pats,
            add=add,
            force=force,
        )
    )


@app.command()
def train(
    dataset: Annotated[Path, typer.Argument(help="Folder that angie prepare made.")],
    settings: Annotated[
        list[str] | None, typer.Argument(help="key=value, or YAML files with such.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder of the speaker bundle.")
    ] = None,
    preset: Annotated[
        str | None, typer.Option(help="paper, lite or tiny; lite for a new bundle.")
    ] = None,
    stage: Annotated[str, typer.Option(help="renderer, motion, vq, gpt, refiner or all.")] = "all",
    resume: Annotated[bool, typer.Option("--resume", help="Go on after an interruption.")] = False,
    seed: Seed = 0,
    device: Device = "auto",
    devices: Annotated[int, typer.Option(min=1, help="GPUs, or processes on the CPU.")] = 1,
    precision: Annotated[
        str, typer.Option(help="Of the renderer: auto, 32-true, bf16-mixed or 16-mixed.")
    ] = "auto",
    workers: Annotated[int, typer.Option(min=0, help="Processes that load data.")] = 0,
    force: Force = False,
) -> None:
    """Train a speaker bundle: renderer, motion, VQ, GPT, refiner."""
    if output is None:
        raise BadInput("--output: name the folder of the bundle, -o BUNDLE")
    from angie.presets import parse_overrides
    from angie.presets import preset as find
    from angie.training import train as run
    from mraa.run import RunConfig

    known = (output / "bundle.json").exists() and (resume or not force)
    chosen = find(preset or "lite") if preset or not known else None
    if precision not in ("auto", "32-true", "bf16-mixed", "16-mixed"):
        raise BadInput(f"--precision {precision}: there are auto, 32-true, bf16-mixed, 16-mixed")
    if device != "auto":
        _device(device)
    how = RunConfig(device=device, devices=devices, precision=precision, workers=workers)
    bundle = run(
        dataset,
        output,
        preset=chosen,
        changes=parse_overrides(settings or []),
        stage=stage,
        resume=resume,
        force=force,
        seed=seed,
        run=how,
    )
    if int(os.environ.get("LOCAL_RANK", "0")) == 0:  # one line, however many processes
        print(f"{bundle.folder}: {', '.join(bundle.manifest['parts'])}")


@app.command()
def info(
    bundle: Annotated[
        Path | None, typer.Argument(help="Speaker bundle; without it the shipped one.")
    ] = None,
) -> None:
    """Tell what a speaker bundle holds and what it was trained on."""
    from angie.bundle import Bundle
    from angie.demo import BUNDLE
    from angie.summary import describe

    print(describe(Bundle.open(bundle or BUNDLE)))


@app.callback(invoke_without_command=True)
def version(
    show: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    """One photo of a speaker and a speech recording in, a video of that person gesturing out."""
    if show:
        print(f"angie {__version__}")
        raise typer.Exit


def _want_file(path: Path, what: str) -> None:
    if not path.exists():
        raise BadInput(f"{path}: no such file; give the {what}")
    if path.is_dir():
        raise BadInput(f"{path}: is a folder; give the {what}")


def _square(text: str) -> "Crop":  # type: ignore[name-defined]  # noqa: F821
    from data_prep.speaker import Crop

    try:
        x, y, size, *height = (int(part) for part in text.split(","))
    except ValueError:
        raise BadInput(f"--crop {text}: give x,y,size in whole pixels") from None
    if len(height) > 1 or size < 1:
        raise BadInput(f"--crop {text}: give x,y,size in whole pixels, the size above 0")
    if height not in ([], [size]):
        raise BadInput(f"--crop {text}: is no square; width and height must be equal")
    return Crop(x, y, size)


def _device(name: str) -> str:
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


def _cores() -> int:
    import os

    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def main() -> None:
    """Run the command; bad input is one line on standard error and exit status 2."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # what is half-written is removed
    try:
        app()
    except BadInput as error:
        console.print(f"angie: {error}", style="red", highlight=False, markup=False, soft_wrap=True)
        sys.exit(2)
    except OSError as error:  # disk full, no permission, a name that is too long ...
        place = f"{error.filename}: " if error.filename else ""
        text = f"angie: {place}{error.strerror or error}"
        console.print(text, style="red", highlight=False, markup=False, soft_wrap=True)
        sys.exit(2)


if __name__ == "__main__":
    main()
