"""What became of a source video: spans that were judged, clips that were kept, and why not."""

from collections import Counter
from dataclasses import dataclass, field

from data_prep.dataset import Clip
from data_prep.media.video import VideoInfo
from data_prep.prepare.source import Source
from data_prep.speaker.crop import Crop, Face


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


@dataclass(frozen=True)
class IngestionConfig:
    """How videos become clips; part of what a finished source is recognised by.

    Attributes:
        crop: square of the picture for every span; None finds it by the speaker's face.
        person: "left", "right" or "largest" where several people are in the picture; None
            refuses such spans.
        stabilize: undo a moving camera; otherwise spans in which it moves are dropped.
        silent_ok: keep videos without sound, for training the renderer only.
        shortest: seconds of the shortest clip that is planned.
        longest: seconds of the longest clip.
    """

    crop: Crop | None = None
    person: str | None = None
    stabilize: bool = False
    silent_ok: bool = False
    shortest: float = 4.0
    longest: float = 14.0
