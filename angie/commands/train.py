"""Commands that make speaker bundles and tell of them: train, import-mraa, info."""

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
    speaker: Annotated[
        str | None, typer.Option(help="Learn only the motion of this speaker of the dataset.")
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
    from angie.config import parse_overrides
    from angie.config import preset as find
    from angie.training import train as run
    from mraa.training.run import RunConfig

    known = (output / "bundle.json").exists() and (resume or not force)
    chosen = find(preset or "lite", generator) if preset or not known else None
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
        run=how,
    )
    if int(os.environ.get("LOCAL_RANK", "0")) == 0:  # one line, however many processes
        print(f"{bundle.folder}: {', '.join(bundle.manifest['parts'])}")


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
        Path | None, typer.Argument(help="Speaker bundle; the shipped one by default.")
    ] = None,
) -> None:
    """Show what a speaker bundle contains and what it was trained on."""
    from angie.bundle import BUNDLE, Bundle
    from angie.parts import describe

    print(describe(Bundle.open(bundle or BUNDLE)))
