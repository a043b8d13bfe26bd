"""Source videos: which files there are, who speaks in them, and what they are called."""

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from data_prep.errors import BadInput

EXTENSIONS = frozenset(
    ".mp4 .m4v .mov .mkv .webm .avi .mpg .mpeg .ts .mts .m2ts .flv .wmv .3gp .ogv".split()
)
"""Endings by which videos are found in a folder; a file named directly may have any."""


@dataclass(frozen=True)
class Source:
    """A video that clips are cut from.

    Attributes:
        path: the file.
        speaker: who speaks in it.
        name: its name in the dataset, unique there; clip ids begin with it.
    """

    path: Path
    speaker: str
    name: str


def _plain(text: str) -> str:
    """Letters, digits, dots, dashes and underscores alone: fit for file names everywhere."""
    return re.sub(r"[^\w.-]+", "-", text).strip("-.") or "video"


def find_sources(paths: Sequence[Path], speaker: str | None = None) -> list[Source]:
    """List videos, searching folders through all their levels, in order of their paths.

    The speaker is `speaker` if given; else, for a video found in a folder, the name of the
    folder that holds it, and for a video named directly, the file's own name.

    Raises:
        BadInput: a path that does not exist, or a folder without videos.
    """
    found: dict[Path, str] = {}
    for path in map(Path, paths):
        if not path.exists():
            raise BadInput(f"{path}: no such file or folder; check the name")
        if path.is_dir():
            inside = sorted(
                p for p in path.rglob("*") if p.suffix.lower() in EXTENSIONS and p.is_file()
            )
            if not inside:
                raise BadInput(f"{path}: holds no videos; name the files or another folder")
            for video in inside:
                found.setdefault(video.resolve(), speaker or video.resolve().parent.name)
        else:
            found.setdefault(path.resolve(), speaker or path.stem)
    sources: list[Source] = []
    taken: set[str] = set()
    for video, who in found.items():
        who, stem = _plain(who), _plain(video.stem)
        name = plain = stem if stem.startswith(who) else f"{who}_{stem}"
        number = 1
        while name.lower() in taken:
            number += 1
            name = f"{plain}-{number}"
        taken.add(name.lower())
        sources.append(Source(video, who, name))
    return sources


def sha256(path: Path) -> str:
    """Hash of a file's content as hexadecimal digits."""
    digest = hashlib.sha256()
    with Path(path).open("rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()
