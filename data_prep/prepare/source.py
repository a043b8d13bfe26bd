"""Source videos: which files there are, who speaks in them, and what became of each."""

import os
import re
import unicodedata
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from data_prep.dataset import Clip
from data_prep.errors import BadInput
from data_prep.media.video import VideoInfo
from data_prep.speaker.crop import Crop, Face

EXTENSIONS = frozenset(
    ".mp4 .m4v .mov .mkv .webm .avi .mpg .mpeg .ts .mts .m2ts .flv .wmv .3gp .ogv".split()
)
"""Endings by which videos are found in a folder; a file named directly may have any."""

_DATASET_FILES = {"dataset.json", "meta.csv"}

_LONGEST_NAME = 160
"""Bytes of a name; file systems allow 255 with the clip's number and the ending."""


@dataclass(frozen=True)
class Source:
    """A video that clips are cut from.

    Attributes:
        path: the file.
        speaker: who speaks in it.
        name: its name in the dataset, unique there; clip ids begin with it.
        intervals: parts to cut, `(id, start, end)` in seconds as the file counts them; empty
            for the whole video.
        person: who is seen, where that is another name than the speaker's; else empty.
    """

    path: Path
    speaker: str
    name: str
    intervals: tuple[tuple[str, float, float], ...] = ()
    person: str = ""


def plain(text: str) -> str:
    """Letters, digits, dots, dashes and underscores only: valid file names everywhere."""
    text = unicodedata.normalize("NFC", text)  # some systems keep accents apart
    return re.sub(r"[^\w.-]+", "-", text).strip("-.") or "video"


def videos_in(folder: Path) -> list[Path]:
    """Videos of a folder through all its levels, in order of their paths.

    Hidden folders and datasets (an earlier output, say) are passed over.

    Raises:
        BadInput: a folder that cannot be read.
    """
    return sorted(_walk(folder))


def _walk(folder: Path) -> Iterator[Path]:
    def refuse(error: OSError) -> None:
        raise BadInput(
            f"{error.filename}: cannot be read ({error.strerror}); "
            "make it readable, or name the other folders and files"
        ) from error

    for here, folders, files in os.walk(folder, onerror=refuse):
        if set(files) >= _DATASET_FILES:
            folders.clear()
            continue
        folders[:] = [name for name in folders if not name.startswith(".")]
        for name in files:
            if Path(name).suffix.lower() in EXTENSIONS and not name.startswith("."):
                yield Path(here) / name


def names_pattern(names: str) -> re.Pattern[str]:
    """What `--names` means: `{person}` any text, `{style}` and `*` any without underscores.

    `{person}_*_{style}_*` finds in `AIAN_F_1_Casual_bella_005` the person `AIAN_F_1` and the style
    `bella`.

    Raises:
        BadInput: neither of the two is in it, or one is twice.
    """
    parts = {"{person}": "(?P<person>.+)", "{style}": "(?P<style>[^_]+)", "*": "[^_]*"}
    pieces = re.split(r"(\{person\}|\{style\}|\*)", names)
    try:
        pattern = re.compile("".join(parts.get(piece) or re.escape(piece) for piece in pieces))
    except re.error:
        pattern = re.compile("")
    if not pattern.groupindex:
        raise BadInput(f"--names {names}: put {{person}} and {{style}} into it, each once")
    return pattern


def named_by(pattern: re.Pattern[str], sources: Sequence[Source]) -> list[Source]:
    """Sources with the person and the style that the names of their files tell.

    Raises:
        BadInput: a name that is built otherwise.
    """
    told = []
    for source in sources:
        match = pattern.fullmatch(source.path.stem)
        if match is None:
            raise BadInput(
                f"{source.path}: is not named as --names says; rename it, or leave it out"
            )
        found = {key: plain(value) for key, value in match.groupdict().items()}
        style = found.get("style") or found.get("person", "")
        person = found.get("person", "")
        told.append(replace(source, speaker=style, person="" if person == style else person))
    return told


def find_sources(paths: Sequence[Path], speaker: str | None = None) -> list[Source]:
    """List videos, searching folders through all their levels, in order of their paths.

    The speaker is `speaker` if given; else, for a video found in a folder, the name of the
    folder that holds it, and for a video named directly, the file's own name.

    Raises:
        BadInput: a path that does not exist, or a folder without videos.
    """
    found: dict[Path, tuple[Path, str]] = {}  # by the file behind a link
    for path in map(Path, paths):
        if not path.exists():
            raise BadInput(f"{path}: no such file or folder; check the name")
        if path.is_dir():
            inside = videos_in(path)
            if not inside:
                raise BadInput(f"{path}: holds no videos; name the files or another folder")
            for video in map(placed, inside):
                found.setdefault(video.resolve(), (video, speaker or video.parent.name))
        else:
            found.setdefault(path.resolve(), (placed(path), speaker or path.stem))
    return name_sources([Source(video, plain(who), "") for video, who in found.values()])


def placed(path: Path) -> Path:
    """The whole path of a file; a link keeps its own name and folder, and what lies beside it."""
    return Path(os.path.abspath(path))


def name_sources(sources: Sequence[Source], taken: Collection[str] = ()) -> list[Source]:
    """Give each source without a name one of its own: the speaker's and the file's.

    Args:
        sources: in order; those with a name keep it.
        taken: names that others have.
    """
    used = {name.lower() for name in taken} | {s.name.lower() for s in sources if s.name}
    named: list[Source] = []
    for source in sources:
        if not source.name:
            stem = plain(source.path.stem)
            told = source.person or stem.startswith(source.speaker)
            first = stem if told else f"{source.speaker}_{stem}"
            first = first.encode()[:_LONGEST_NAME].decode(errors="ignore")
            name, number = first, 1
            while name.lower() in used:
                number += 1
                name = f"{first}-{number}"
            used.add(name.lower())
            source = replace(source, name=name)
        named.append(source)
    return named


@dataclass(frozen=True)
class Span:
    """A part of a video that was judged as a whole: a shot, or a part of one.

    Attributes:
        first: its first frame, counted at 25 fps from the video's first frame.
        stop: one past its last frame.
        reason: why nothing of it was kept, None if it was used.
        crop: square that was cut out, None where it was refused before.
        face: the speaker's, median over the span, in pixels of the picture.
        filled: part of the crop, 0 to 1, that lies outside the picture and repeats its edge.
    """

    first: int
    stop: int
    reason: str | None = None
    crop: Crop | None = None
    face: Face | None = None
    filled: float = 0.0


@dataclass(frozen=True)
class ClipDetail:
    """What the report needs of a clip besides its row in the table.

    Attributes:
        span: number of the span it was cut from.
        face_height: of the speaker's median face, in pixels of the original picture.
        motion: mean grey level, of 255, by which neighbouring frames differ.
    """

    span: int
    face_height: float
    motion: float


@dataclass
class Outcome:
    """What became of a source.

    Attributes:
        source: the video.
        sha256: of the file.
        info: what the file holds, None when it could not be read.
        spans: parts of the video in order of time.
        clips: that were kept; their splits are not decided yet.
        details: of each clip, by id.
        dropped: seconds dropped, by reason (refused spans and rejected clips).
        refused: why nothing of the video was kept, or None.
    """

    source: Source
    sha256: str = ""
    info: VideoInfo | None = None
    spans: list[Span] = field(default_factory=list)
    clips: list[Clip] = field(default_factory=list)
    details: dict[str, ClipDetail] = field(default_factory=dict)
    dropped: Counter[str] = field(default_factory=Counter)
    refused: str | None = None


MIN_FRAMES = 97
"""A clip with fewer frames gives no window of 96 frame-to-frame differences."""

MIN_DRAWN = 2
"""Frames of the shortest clip that a renderer can be trained on: it takes pairs."""


@dataclass(frozen=True)
class IngestionConfig:
    """How videos become clips; part of what a finished source is recognised by.

    Attributes:
        crop: square of the picture for every span; None finds it by the speaker's face.
        person: "left", "right" or "largest" where several people are in the picture; None
            refuses such spans.
        stabilize: undo a moving camera; otherwise spans in which it moves are dropped.
        silent_ok: keep videos without sound and clips too short for motion, for training the
            renderer only.
        shortest: seconds of the shortest clip that is planned.
        longest: seconds of the longest clip.
        face_network: hash of the network that finds faces, "" for the cascades alone.
    """

    crop: Crop | None = None
    person: str | None = None
    stabilize: bool = False
    silent_ok: bool = False
    shortest: float = 4.0
    longest: float = 14.0
    face_network: str = ""

    @property
    def fewest(self) -> int:
        """Frames of the shortest clip that is kept."""
        return MIN_DRAWN if self.silent_ok else MIN_FRAMES

    @property
    def too_short(self) -> str:
        """Why a part of a video with fewer frames is dropped."""
        return f"shorter than {self.fewest} frames"
