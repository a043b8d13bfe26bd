"""From videos of speakers to a dataset: `angie prepare`."""

import json
import multiprocessing
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2

from data_prep.clip_files import FOLDERS
from data_prep.dataset import FORMAT, MANIFEST, TABLE, Clip, write_table
from data_prep.errors import BadInput
from data_prep.ingestion import ingest, words_beside
from data_prep.outcome import IngestionConfig, Outcome
from data_prep.output import check_apart, check_output, whole_folder
from data_prep.progress import progress
from data_prep.rates import FPS, IMAGE_SIZE, SAMPLE_RATE
from data_prep.source import Source, find_sources
from data_prep.speaker import Crop
from data_prep.split import split_clips
from data_prep.video import probe
from data_prep.words import Word

_MESSAGE_REASONS = 3


@dataclass(frozen=True)
class Summary:
    """What `prepare` made.

    Attributes:
        path: the dataset.
        clips: all that were kept.
        rules: how the clips of each speaker were divided into training and test.
        dropped: seconds dropped, by reason.
        refused: videos of which nothing was kept, with the reason.
    """

    path: Path
    clips: list[Clip]
    rules: dict[str, str]
    dropped: dict[str, float]
    refused: list[tuple[Path, str]]

    def __str__(self) -> str:
        """A few lines for a person."""
        lines = [f"{self.path}: {len(self.clips)} clips, {_minutes(self.clips)}"]
        for speaker, rule in self.rules.items():
            own = [clip for clip in self.clips if clip.speaker == speaker]
            test = [clip for clip in own if clip.split == "test"]
            lines.append(
                f"  {speaker}: {len(own)} clips, {_minutes(own)}; {len(test)} for testing ({rule})"
            )
        lines += [
            f"  dropped {seconds:.1f} s: {reason}" for reason, seconds in self.dropped.items()
        ]
        lines += [f"  refused {path}: {reason}" for path, reason in self.refused]
        return "\n".join(lines)


def _minutes(clips: Sequence[Clip]) -> str:
    return f"{sum(clip.n_frames for clip in clips) / FPS / 60:.1f} min"


def prepare(
    videos: Sequence[Path],
    output: Path,
    *,
    speaker: str | None = None,
    jobs: int = 1,
    crop: Crop | None = None,
    force: bool = False,
) -> Summary:
    """Turn videos of speakers into a dataset of square clips with sound and features.

    The speaker is found by the face, a fixed square around the upper body is brought to
    256x256 at exactly 25 fps, and the video is cut into clips of 4 to 14 s where it is
    quietest. A video that cannot be used is listed with the reason and the others go on.

    Args:
        videos: files, or folders that are searched through all their levels.
        output: the dataset to write; it appears when it is whole.
        speaker: who speaks in all of them; None takes the folders' or files' names.
        jobs: processes.
        crop: square of all the pictures in pixels; None finds it by the speaker's face.
        force: replace an existing output.

    Raises:
        BadInput: no such video, an output that cannot be written, or nothing was kept.
    """
    check_output(output, force=force)
    check_apart(output, videos)
    sources = find_sources(videos, speaker)
    with whole_folder(output, mark=MANIFEST, force=force) as part:
        for folder in FOLDERS:
            (part / folder).mkdir()
        with progress("prepare", len(sources), "videos") as advance:
            outcomes = []
            for outcome in _ingest_all(sources, part, crop, jobs):
                outcomes.append(outcome)
                advance(1, note=outcome.source.name)
        order = {source.name: number for number, source in enumerate(sources)}
        outcomes.sort(key=lambda outcome: order[outcome.source.name])
        clips, rules = split_clips([clip for outcome in outcomes for clip in outcome.clips])
        if not clips:
            raise BadInput(_nothing_kept(outcomes))
        write_table(part / TABLE, clips, FPS)
        text = json.dumps(_manifest(outcomes, rules), indent=1, ensure_ascii=False)
        (part / MANIFEST).write_text(text + "\n", encoding="utf-8")
    dropped = sum((outcome.dropped for outcome in outcomes), Counter())
    refused = [(o.source.path, o.refused) for o in outcomes if o.refused is not None]
    return Summary(Path(output), clips, rules, dict(dropped), refused)


def _ingest_all(
    sources: list[Source], folder: Path, crop: Crop | None, jobs: int
) -> Iterator[Outcome]:
    """Outcomes as they come; each process works on one video at a time."""
    jobs = min(jobs, len(sources))
    if jobs <= 1:
        for source in sources:
            yield _ingest(source, folder, crop)
        return
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(jobs, context, initializer=cv2.setNumThreads, initargs=(1,))
    try:
        tasks = [pool.submit(_ingest, source, folder, crop) for source in sources]
        for task in as_completed(tasks):
            yield task.result()
    finally:
        pool.shutdown(cancel_futures=True)


def _ingest(source: Source, folder: Path, crop: Crop | None) -> Outcome:
    try:
        words = _words(source.path)
    except BadInput as error:
        return Outcome(source, refused=str(error))
    return ingest(source, folder, IngestionConfig(crop=crop), words)


def _words(path: Path) -> list[Word] | None:
    if not path.with_suffix(".words.json").exists():
        return None
    return words_beside(path, probe(path).start)


def _nothing_kept(outcomes: list[Outcome]) -> str:
    reasons = [f"{o.source.path.name}: {o.refused}" for o in outcomes[:_MESSAGE_REASONS]]
    more = len(outcomes) - len(reasons)
    return "nothing of the videos can be used: " + "; ".join(
        reasons + ([f"and {more} more"] if more > 0 else [])
    )


def _manifest(outcomes: list[Outcome], rules: dict[str, str]) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "fps": FPS,
        "size": IMAGE_SIZE,
        "sample_rate": SAMPLE_RATE,
        "splits": rules,
        "sources": [
            {
                "name": o.source.name,
                "file": o.source.path.name,
                "sha256": o.sha256,
                "speaker": o.source.speaker,
                "video": None if o.info is None else asdict(o.info),
                "crop": next((asdict(s.crop) for s in o.spans if s.crop is not None), None),
                "clips": len(o.clips),
                "seconds": round(sum(clip.n_frames for clip in o.clips) / FPS, 2),
                "dropped": dict(o.dropped),
                "refused": o.refused,
            }
            for o in outcomes
        ],
    }
