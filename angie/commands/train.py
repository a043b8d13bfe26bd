"""Commands that make speaker bundles and tell of them: train, teach, import-mraa, info."""

import os
from pathlib import Path
from typing import Annotated

import typer

from angie.commands.options import Device, Force, Generator, Seed, Settings, device_of, want_file
from data_prep.errors import BadInput, check_choice


def train(
    dataset: Annotated[Path, typer.Argument(help="Folder that angie prepare made.")],
    settings: Settings = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder of the speaker bundle.")
    ] = None,
    preset: Annotated[
        str | None, typer.Option(help="paper, lite or tiny; lite for a new bundle.")
    ] = None,
    generator: Generator = None,
    stage: Annotated[
        str,
        typer.Option(
            help="renderer, motion, a stage of the generator (angie info lists its parts), avd, or "
            "all but avd."
        ),
    ] = "all",
    also: Annotated[
        list[str] | None,
        typer.Option(
            help="A further dataset for the renderer, DATASET or DATASET:WEIGHT: so many pairs of "
            "frames for each one of the first dataset. May be given several times."
        ),
    ] = None,
    speaker: Annotated[
        str | None, typer.Option(help="Learn only the motion of this speaker of the dataset.")
    ] = None,
    origin: Annotated[
        str | None,
        typer.Option(
            "--from",
            help="Bundle whose renderer is trained on, its regions frozen; shipped names the one "
            "of the package. With --stage renderer the new bundle gestures as that one does.",
        ),
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue an interrupted training.")
    ] = False,
    seed: Seed = 0,
    device: Device = "auto",
    devices: Annotated[int, typer.Option(min=1, help="GPUs, or processes on the CPU.")] = 1,
    precision: Annotated[
        str, typer.Option(help="Of the renderer: auto, 32-true, bf16-mixed or 16-mixed.")
    ] = "auto",
    workers: Annotated[
        int, typer.Option(min=0, help="Processes that load data and, on a CPU, measure motion.")
    ] = 0,
    force: Force = False,
) -> None:
    """Train a speaker bundle: the renderer, its motion, and a gesture generator."""
    if output is None:
        raise BadInput("--output: name the folder of the bundle, -o BUNDLE")
    from angie.bundle import BUNDLE
    from angie.config import parse_overrides
    from angie.config import preset as find
    from angie.training import train as run
    from mraa.training.run import RunConfig

    known = (output / "bundle.json").exists() and (resume or not force)
    if origin is not None and preset is not None:
        raise BadInput("--from and --preset: give one; the sizes are those of the bundle")
    given = preset is not None or (origin is None and not known)
    chosen = find(preset or "lite", generator) if given else None
    check_choice("--precision", precision, ("auto", "32-true", "bf16-mixed", "16-mixed"))
    if device != "auto":
        device_of(device)
    how = RunConfig(device=device, devices=devices, precision=precision, workers=workers)
    bundle = run(
        dataset,
        output,
        preset=chosen,
        changes=parse_overrides(settings or []),
        generator=generator,
        stage=stage,
        resume=resume,
        force=force,
        seed=seed,
        speaker=speaker,
        also=[weighted(text) for text in also or []],
        origin=None if origin is None else BUNDLE if origin == "shipped" else Path(origin),
        run=how,
    )
    if int(os.environ.get("LOCAL_RANK", "0")) == 0:  # one line, however many processes
        print(f"{bundle.folder}: {', '.join(bundle.manifest['parts'])}")


def teach(
    dataset: Annotated[Path, typer.Argument(help="Folder that angie prepare made.")],
    settings: Settings = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="The .safetensors to write.")
    ] = None,
    models: Annotated[
        Path | None,
        typer.Option(help="Folder of MediaPipe's networks, which see bodies and hands."),
    ] = None,
    truth: Annotated[
        Path | None,
        typer.Option(help="Folder of drawn people's videos with their truth (angie phantom)."),
    ] = None,
    preset: Annotated[str, typer.Option(help="paper, lite or tiny.")] = "lite",
    region_steps: Annotated[int, typer.Option(min=1, help="Steps of the regions.")] = 900,
    mask_steps: Annotated[int, typer.Option(min=1, help="Steps of the masks.")] = 1500,
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue an interrupted teaching.")
    ] = False,
    seed: Seed = 0,
    device: Device = "auto",
    force: Force = False,
) -> None:
    """Teach a renderer where limbs are; train begins with it by train_renderer.initial=FILE."""
    if output is None:
        raise BadInput("--output: name the weights to write, -o OUT.safetensors")
    from angie.config import override, parse_overrides
    from angie.config import preset as find
    from angie.teaching import teach_dataset
    from mraa.training.run import RunConfig, native_precision
    from mraa.training.teach import Teaching

    place = device_of(device)
    clips = teach_dataset(
        dataset,
        output,
        override(find(preset), parse_overrides(settings or [])),
        truth=truth,
        models=models,
        how=Teaching(region_steps, mask_steps),
        seed=seed,
        run_config=RunConfig(device=place, precision=native_precision(place)),
        resume=resume,
        force=force,
    )
    print(f"{output}: taught by {clips} clips")


def weighted(text: str) -> tuple[Path, float]:
    """A dataset and its weight of DATASET or DATASET:WEIGHT."""
    place, colon, number = text.rpartition(":")
    try:
        return (Path(place), float(number)) if colon and place else (Path(text), 1.0)
    except ValueError:  # a colon of the path's own
        return Path(text), 1.0


def import_mraa(
    checkpoint: Annotated[Path, typer.Argument(help="A released .pth of MRAA.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder of the bundle.")],
    config: Annotated[
        Path | None, typer.Option(help="Its MRAA YAML file, for what the weights do not show.")
    ] = None,
    preset: Annotated[
        str, typer.Option(help="Sizes of the stages still to be trained: paper, lite or tiny.")
    ] = "paper",
    force: Force = False,
) -> None:
    """Turn a released MRAA checkpoint into a speaker bundle with a renderer."""
    from angie.config import preset as find
    from angie.released import import_released

    want_file(checkpoint, "checkpoint")
    bundle = import_released(checkpoint, output, config, find(preset), force=force)
    print(f"{bundle.folder}: {', '.join(bundle.manifest['parts'])}")


def info(
    bundle: Annotated[
        Path | None,
        typer.Argument(help="Speaker bundle, the shipped one by default; or a video of angie's."),
    ] = None,
) -> None:
    """Show what a speaker bundle contains and was trained on, or where a video comes from."""
    from angie.provenance import RECORD, read_origin

    if bundle is not None and (bundle.is_file() or (bundle / RECORD).is_file()):
        print(read_origin(bundle))
        return
    from angie.bundle import BUNDLE, Bundle
    from angie.parts import describe

    print(describe(Bundle.open(bundle or BUNDLE)))
