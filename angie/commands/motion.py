"""Commands of the motion side: gestures, codebook, ablate."""

from pathlib import Path
from typing import Annotated

import typer

from angie.commands.options import Device, Force, Seed, Style, device_of, want_file
from data_prep.errors import BadInput
from data_prep.rates import FPS


def gestures(
    bundle: Annotated[Path, typer.Argument(help="Bundle of joints or of regions.")],
    audio: Annotated[Path, typer.Argument(help="Any recording, or a video with sound.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The .npz or .npy to write.")],
    start: Annotated[
        Path | None, typer.Option(help="Motion to begin with the first frame of.")
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
    fps: Annotated[float, typer.Option(min=1, max=1000, help="Frames a second of joints.")] = FPS,
    seed: Seed = 0,
    greedy: Annotated[
        bool,
        typer.Option(
            "--greedy",
            help="Always the likeliest gesture, whatever the seed; without it gestures are "
            "sampled, whatever generation.sampling.method the bundle has.",
        ),
    ] = False,
    force: Force = False,
) -> None:
    """Write the motion for a recording as arrays: joints (T, J, 2), or regions."""
    from data_prep.output import check_output

    check_output(output, force=force)
    want_file(audio, "recording")
    if start is not None:
        want_file(start, "motion to begin with")
    from angie.bundle import Bundle
    from angie.gestures import gestures as make

    frames = make(
        Bundle.open(bundle),
        audio,
        output,
        start=start,
        speaker=speaker,
        style=style,
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
    codes: Annotated[int, typer.Option(min=1, max=24, help="Pairs of codes, the rows.")] = 6,
    person: Annotated[
        str | None, typer.Option(help="Of several people: left, right or largest.")
    ] = None,
    force: Force = False,
) -> None:
    """Show codes of the motion codebooks on photos, and how much each is used."""
    for photo in photos:
        want_file(photo, "photo")
    from angie.bundle import Bundle
    from angie.code_sheet import code_sheet

    sheet = code_sheet(Bundle.open(bundle), photos, output, count=codes, person=person, force=force)
    print(f"{sheet.picture}, {sheet.video}: {len(sheet.pairs)} pairs of codes")


def ablate(
    dataset: Annotated[Path, typer.Argument(help="Folder that angie prepare made.")],
    bundle: Annotated[Path, typer.Argument(help="Bundle whose renderer and settings all share.")],
    settings: Annotated[
        list[str] | None, typer.Argument(help="key=value, or YAML files with such.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder of bundles, report and table.")
    ] = None,
    variants: Annotated[
        str | None, typer.Option(help="Some of the rows, with commas; without it all.")
    ] = None,
    seeds: Annotated[int, typer.Option(min=1, max=100, help="Runs of what is random.")] = 1,
    no_images: Annotated[
        bool, typer.Option("--no-images", help="Render nothing: motion scores alone.")
    ] = False,
    image_stride: Annotated[
        int, typer.Option(min=2, help="Every so many frames two are rendered for image scores.")
    ] = 25,
    image_seconds: Annotated[
        float,
        typer.Option(
            min=0, help="Score pictures of the first so many seconds of each clip; 0: of all."
        ),
    ] = 0.0,
    fgd: Annotated[
        Path | None, typer.Option(help="Auto-encoder of an earlier report, to compare with it.")
    ] = None,
    fgd_steps: Annotated[
        int, typer.Option(min=1, help="Most training steps of FGD's auto-encoder.")
    ] = 3000,
    seed: Seed = 0,
    device: Device = "auto",
) -> None:
    """Train and score the variants of the paper's Table 3; a killed run goes on when repeated."""
    if output is None:
        raise BadInput("--output: name the folder of the ablations, -o DIR")
    if fgd is not None:
        want_file(fgd, "auto-encoder of a report")
    from angie.ablation import VARIANTS
    from angie.ablation import ablate as run
    from angie.evaluation.networks import EvaluationConfig
    from angie.presets import parse_overrides
    from mraa.run import RunConfig

    place = device_of(device)
    chosen = VARIANTS if variants is None else [name.strip() for name in variants.split(",")]
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
        changes=parse_overrides(settings or []),
        config=scoring,
        seed=seed,
        run=RunConfig(device=device),
        device=place,
    )
    print(text)
    print(f"{output}: table3.md, report, a bundle for each row")
