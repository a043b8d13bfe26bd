"""Commands that make data: phantom, prepare."""

import json
from pathlib import Path
from typing import Annotated

import typer

from angie import __version__
from angie.commands.options import Force, Jobs, Models, Ray, Seed, cores, square_of
from data_prep.errors import BadInput, check_choice


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
    """Write videos of the phantom speaker, with their ground truth."""
    from data_prep.files import whole_folder
    from data_prep.phantom.make import make_phantom

    with whole_folder(output, mark="phantom.json", force=force) as part:
        videos = make_phantom(
            part,
            minutes=minutes,
            seed=seed,
            presenters=presenters,
            jobs=jobs or cores(),
            voice=voice,
        )
        origin = {"angie": __version__, "minutes": minutes, "presenters": presenters, "seed": seed,
                  "voice": voice}  # fmt: skip
        (part / "phantom.json").write_text(json.dumps(origin) + "\n")
    print(f"{output}: {len(videos)} videos of {presenters} presenters")


def prepare(
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder of the dataset.")],
    videos: Annotated[
        list[Path] | None, typer.Argument(help="Videos, or folders of videos.")
    ] = None,
    speaker: Annotated[
        str | None,
        typer.Option(
            help="Name of the speaker; by default the folder's. With --pats: only this one."
        ),
    ] = None,
    names: Annotated[
        str | None,
        typer.Option(
            help="How files are named, such as '{person}_*_{style}_*': who is seen, and whose way "
            "of gesturing it is. Nobody is then in two splits."
        ),
    ] = None,
    crop: Annotated[
        str | None, typer.Option(help="Square of the picture: x,y,size or x,y,w,h in pixels.")
    ] = None,
    person: Annotated[
        str | None, typer.Option(help="Which of several people: left, right or largest.")
    ] = None,
    stabilize: Annotated[
        bool, typer.Option("--stabilize", help="Hold the picture still where the camera moves.")
    ] = False,
    silent_ok: Annotated[
        bool,
        typer.Option(
            "--silent-ok", help="Keep videos without sound and short clips (for the renderer only)."
        ),
    ] = False,
    shortest: Annotated[float, typer.Option(min=3.9, help="Seconds of the shortest clip.")] = 4.0,
    longest: Annotated[float, typer.Option(help="Seconds of the longest clip.")] = 14.0,
    pats: Annotated[
        Path | None, typer.Option(help="PATS' table of intervals; only these are cut.")
    ] = None,
    folder: Annotated[
        list[Path] | None, typer.Option("--videos", help="Folder with the videos of --pats.")
    ] = None,
    models: Models = None,
    jobs: Jobs = 0,
    add: Annotated[
        bool, typer.Option("--add", help="Add other videos to the existing dataset.")
    ] = False,
    ray: Ray = None,
    force: Force = False,
) -> None:
    """Cut videos of a speaker into a dataset of clips.

    Repeated, the command goes on where it was killed, or makes what videos have come since.
    """
    from data_prep.prepare.prepare import prepare as make
    from data_prep.prepare.source import IngestionConfig

    places = [*(videos or []), *(folder or [])]
    if not places:
        raise BadInput("no video given; name videos or folders of videos")
    if person is not None:
        check_choice("--person", person, ("left", "right", "largest"))
    if not 2 * shortest <= longest <= 60:
        raise BadInput(f"--longest {longest:g}: must be twice --shortest {shortest:g}, at most 60")
    if names is not None and (speaker is not None or pats is not None):
        raise BadInput("--names says who speaks; leave --speaker and --pats out")
    if add and force:
        raise BadInput("--add and --force: give one; --add keeps the dataset, --force replaces it")
    config = IngestionConfig(
        crop=None if crop is None else square_of(crop),
        person=person,
        stabilize=stabilize,
        silent_ok=silent_ok,
        shortest=shortest,
        longest=longest,
    )
    print(
        make(
            places,
            output,
            speaker=speaker,
            names=names,
            jobs=jobs or cores(),
            config=config,
            models=models,
            pats=pats,
            add=add,
            force=force,
            ray=ray,
        )
    )
