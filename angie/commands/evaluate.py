"""`angie evaluate`: the tables of the papers on a dataset."""

from pathlib import Path
from typing import Annotated, Any

import typer

from angie.commands import options
from data_prep.errors import BadInput, check_choice
from data_prep.progress import console


def evaluate(
    places: Annotated[
        list[Path] | None,
        typer.Argument(
            help="A dataset, then the speaker bundles to compare; or a folder of joints, then "
            "models of joints and folders of arrays."
        ),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder of the report.")
    ] = None,
    videos: Annotated[
        Path | None, typer.Option(help="Score a folder of videos of any system instead.")
    ] = None,
    reference: Annotated[
        Path | None, typer.Option(help="With --videos: the dataset they are compared with.")
    ] = None,
    bundle: Annotated[
        Path | None,
        typer.Option(
            help="With --videos: bundle that measures regions; the shipped one by default."
        ),
    ] = None,
    seeds: options.Seeds = 1,
    seed: options.Seed = 0,
    generator: Annotated[
        str | None,
        typer.Option(help="Score this generator of each bundle; by default all of them."),
    ] = None,
    start: Annotated[
        str,
        typer.Option(help="Begin with the clip's own motion (truth) or still, as a photo (pose)."),
    ] = "truth",
    no_images: options.NoImages = False,
    image_stride: options.ImageStride = 25,
    image_seconds: options.ImageSeconds = 0.0,
    videos_shown: Annotated[
        int, typer.Option(min=0, help="Number of clips to make side-by-side videos of.")
    ] = 2,
    fgd: options.Fgd = None,
    fgd_steps: options.FgdSteps = 3000,
    truth: Annotated[
        Path | None, typer.Option(help="Folder that angie phantom made, for its true joints.")
    ] = None,
    models: Annotated[
        Path | None,
        typer.Option(
            help="Folder of MediaPipe's networks, which look for hands and faces in the pictures."
        ),
    ] = None,
    detected: Annotated[
        Path | None,
        typer.Option(
            help="With --videos: folder with NAME.npz of your re-identification network "
            "and detector: real_, made_ embeddings and points."
        ),
    ] = None,
    greedy: Annotated[
        bool,
        typer.Option(
            "--greedy",
            help="Always the likeliest gesture, as the papers' tables; else as the bundle is set.",
        ),
    ] = False,
    perceptual_weights: Annotated[
        Path | None, typer.Option(help="File of VGG19's weights for the perceptual distance.")
    ] = None,
    device: options.Device = "auto",
    force: options.Force = False,
) -> None:
    """Score generators, baselines and the truth on the test clips of a dataset."""
    if output is None:
        raise BadInput("--output: name the folder of the report, -o REPORT")
    check_choice("--start", start, ("truth", "pose"))
    for path, what in ((fgd, "autoencoder of a report"), (perceptual_weights, "weights")):
        if path is not None:
            options.want_file(path, what)
    from angie.evaluation.networks import EvaluationConfig
    from angie.evaluation.report import terminal_table

    config = EvaluationConfig(
        seeds=seeds,
        seed=seed,
        start=start,
        images=not no_images,
        image_stride=image_stride,
        image_seconds=image_seconds,
        videos_shown=videos_shown,
        fgd=fgd,
        fgd_steps=fgd_steps,
        truth=truth,
        models=models,
        detected=detected,
        greedy=greedy,
        perceptual_weights="" if perceptual_weights is None else str(perceptual_weights),
    )
    if models is not None and no_images:
        raise BadInput("--models and --no-images: give one; the networks look at pictures")
    if models is not None and videos is not None:
        raise BadInput("--models goes with DATASET BUNDLE...")
    if videos is None:
        if reference is not None or bundle is not None:
            raise BadInput("--reference and --bundle go with --videos; name DATASET BUNDLE...")
        if detected is not None:
            raise BadInput("--detected goes with --videos")
        chosen: Any = {"generator": generator, "force": force}
        if not places or len(places) < 2:
            raise BadInput("give a dataset and one or more speaker bundles: DATASET BUNDLE...")
        from angie.evaluation.evaluate import evaluate as run
        from angie.evaluation.skeletons import evaluate_joints
        from angie.motion.keypoints import INDEX

        if (places[0] / INDEX).is_file():
            for option, given in (("--truth", truth), ("--models", models)):
                if given is not None:
                    raise BadInput(f"{option} goes with a dataset of videos")
            numbers = evaluate_joints(places[0], places[1:], output, config, **chosen)
        else:
            place = options.device_of(device)
            numbers = run(places[0], places[1:], output, config, device=place, **chosen)
    else:
        if places:
            raise BadInput("--videos: takes no DATASET BUNDLE...; name --reference and --bundle")
        if generator is not None:
            raise BadInput("--generator goes with DATASET BUNDLE...")
        if reference is None:
            raise BadInput("--videos: name the dataset to compare with, --reference DATASET")
        from angie.bundle import BUNDLE
        from angie.evaluation.external import evaluate_videos

        numbers = evaluate_videos(
            videos,
            reference,
            bundle or BUNDLE,
            output,
            config,
            device=options.device_of(device),
            force=force,
        )
    for space in numbers["spaces"]:
        for line in space["warnings"]:
            console.print(f"note: {line}", highlight=False, markup=False, soft_wrap=True)
    print(terminal_table(numbers))
    print(f"{output}: report.html, table.csv, results.json")
