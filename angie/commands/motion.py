"""Commands of the motion side: gestures, codebook, ablate."""

from pathlib import Path
from typing import Annotated

import typer

from angie.commands.options import (
    Device,
    Fgd,
    FgdSteps,
    Force,
    Generator,
    Greedy,
    ImageSeconds,
    ImageStride,
    NoImages,
    Person,
    Seed,
    Seeds,
    Settings,
    Style,
    Words,
    device_of,
    want_file,
)
from data_prep.errors import BadInput
from data_prep.rates import FPS


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
