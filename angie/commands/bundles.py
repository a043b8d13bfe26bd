"""Commands that make speaker bundles and tell of them: train, info."""

import os
from pathlib import Path
from typing import Annotated

import typer

from angie.commands.options import Device, Force, Seed, device_of
from data_prep.errors import BadInput


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
        device_of(device)
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
