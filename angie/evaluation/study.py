"""A study of what people see: a page of pairs to compare, blind, and the counting of answers.

ANGIE asks for realness, synchrony and diversity (its Table 2, marks from 1 to 5). Here people
compare two videos at a time, which needs no scale, and further pairs show the same video with its
own sound and with another clip's: how often the own one is preferred tells whether the people can
judge synchrony, and whether motion belongs to its sound at all (the mismatching of the GENEA
challenges and of the large studies after them). No answers come with the kit.
"""

import hashlib
import json
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from angie.evaluation.report import MARK as REPORT
from angie.evaluation.rows import REFERENCES, TRUE_REGIONS
from angie.evaluation.videos import STRIP
from angie.video import COMMENT
from data_prep.errors import BadInput
from data_prep.files import check_apart, whole_folder
from data_prep.media.audio import read_sound
from data_prep.media.video import read_frames
from data_prep.media.writer import VideoWriter
from data_prep.page import page_template
from data_prep.progress import progress
from data_prep.rates import FPS, IMAGE_SIZE, SAMPLE_RATE

KEY, PAGE, GUIDE = "key.json", "page", "README.txt"
"""What a study holds: what is shown where, the folder for participants, and how it is done."""

QUESTIONS = {
    "realness": "In which video does the person move more like a real person?",
    "synchrony": "In which video do the movements fit the speech better?",
    "diversity": "In which video are the movements more varied?",
}

CHOICES = ("left", "right", "same")

CONTROL = "control"
"""Kind of the pairs that show one video with two sounds; those of two rows are of kind "rows"."""

RESAMPLES = 2000
"""Drawings of participants for an interval of 95 %."""


@dataclass(frozen=True)
class Shown:
    """A video of the study.

    Attributes:
        video: name of its file, which tells nothing.
        clip: name of the clip whose motion is shown.
        row: of the report: who made the motion.
        sound: name of the clip whose sound is heard.
    """

    video: str
    clip: str
    row: str
    sound: str


@dataclass(frozen=True)
class Pair:
    """Two videos that are compared; the first is the own sound in pairs of kind "control"."""

    number: int
    kind: str
    first: Shown
    second: Shown


def make_study(
    report: Path, output: Path, *, rows: Sequence[str] | None = None, seed: int = 0,
    force: bool = False,
) -> str:  # fmt: skip
    """Make a study of the side-by-side videos of a report.

    Args:
        report: folder that `angie evaluate` wrote, with at least two videos.
        output: folder of the study: `page` for participants, `key.json`, `README.txt`.
        rows: whose motion is compared; None takes the true regions and all systems.
        seed: of the names of the files.
        force: replace a study that exists.

    Returns:
        one line that says what was made.

    Raises:
        BadInput: no report, too few videos, or rows that it does not show.
    """
    check_apart(output, [report])
    columns, videos = _contents(Path(report))
    if rows is None:
        rows = [name for name in columns if name == TRUE_REGIONS or name not in REFERENCES]
    unknown = [name for name in rows if name not in columns]
    if unknown:
        raise BadInput(f"--rows {','.join(unknown)}: choose from {', '.join(columns)}")
    if len(rows) < 2:
        raise BadInput(f"{report}: shows {', '.join(rows)}; two rows are compared at least")
    pairs = _pairs([video.stem for video in videos], list(rows), seed)
    shown = {one.video: one for pair in pairs for one in (pair.first, pair.second)}
    with whole_folder(output, mark=KEY, force=force) as part:
        (part / PAGE / "videos").mkdir(parents=True)
        sounds = {video.stem: read_sound(video) for video in videos}
        with progress("videos of the study", len(shown), "videos") as advance:
            for video in videos:
                own = [one for one in shown.values() if one.clip == video.stem]
                _write_clips(video, part / PAGE / "videos", own, list(columns), sounds)
                advance(len(own))
        key: dict[str, Any] = {"rows": list(rows), "pairs": [asdict(pair) for pair in pairs]}
        key["study"] = hashlib.sha256(json.dumps(key, sort_keys=True).encode()).hexdigest()[:16]
        (part / KEY).write_text(json.dumps(key, indent=1) + "\n")
        public = [[pair.number, pair.first.video, pair.second.video] for pair in pairs]
        template = page_template("angie.evaluation", "study.html.j2")
        page = template.render(study=key["study"], pairs=public, questions=QUESTIONS)
        (part / PAGE / "index.html").write_text(page, encoding="utf-8")
        guide = page_template("angie.evaluation", "study.txt.j2")
        (part / GUIDE).write_text(guide.render(pairs=len(pairs), questions=QUESTIONS))
    control = sum(pair.kind == CONTROL for pair in pairs)
    return f"{output}: {len(pairs)} pairs, {control} of them controls; see {GUIDE}"


def _contents(report: Path) -> tuple[list[str], list[Path]]:
    """Names of the columns after the recorded one, and the videos of a report's first space."""
    try:
        space = json.loads((report / REPORT).read_text(encoding="utf-8"))["spaces"][0]
        names = [str(row["name"]) for row in space["rows"]]
        videos = [report / name for name in space["videos"]]
    except (OSError, ValueError, KeyError, IndexError, TypeError) as error:
        raise BadInput(f"{report}: is not a report of angie evaluate (no {REPORT})") from error
    if len(videos) < 2:
        raise BadInput(
            f"{report}: has {len(videos)} videos, two are wanted; angie evaluate --videos-shown 4"
        )
    return [TRUE_REGIONS if name == "ground truth" else name for name in names], videos


def _pairs(clips: Sequence[str], rows: Sequence[str], seed: int) -> list[Pair]:
    """All pairs of rows for every clip, and for every row and clip the control pair."""
    codes = np.random.default_rng(seed).permutation(10_000)
    known: dict[tuple[str, str, str], Shown] = {}

    def shown(clip: str, row: str, sound: str) -> Shown:
        code = f"{codes[len(known)]:04}"
        return known.setdefault((clip, row, sound), Shown(code, clip, row, sound))

    pairs: list[Pair] = []
    for place, clip in enumerate(clips):
        other = clips[(place + 1) % len(clips)]
        for index, row in enumerate(rows):
            for second in rows[index + 1 :]:
                both = shown(clip, row, clip), shown(clip, second, clip)
                pairs.append(Pair(len(pairs), "rows", *both))
            both = shown(clip, row, clip), shown(clip, row, other)
            pairs.append(Pair(len(pairs), CONTROL, *both))
    return pairs


def _write_clips(
    video: Path,
    folder: Path,
    shown: Sequence[Shown],
    columns: Sequence[str],
    sounds: Mapping[str, np.ndarray],
) -> None:
    """Write what is shown of a side-by-side video: one column each, with its own or other sound."""
    writers = []
    try:
        for one in shown:
            writers.append(
                VideoWriter(
                    folder / f"{one.video}.mp4", (IMAGE_SIZE, IMAGE_SIZE), FPS,
                    sound=(sounds[one.sound], SAMPLE_RATE), comment=COMMENT, fit=True,
                )
            )  # fmt: skip
        for frame in read_frames(video):
            for one, writer in zip(shown, writers, strict=True):
                left = IMAGE_SIZE * (1 + columns.index(one.row))
                writer.write(np.ascontiguousarray(frame[STRIP:, left : left + IMAGE_SIZE]))
    finally:
        for writer in writers:
            writer.close()


@dataclass(frozen=True)
class Count:
    """What people said of two videos.

    Attributes:
        question: one of `QUESTIONS`.
        kind: "rows" or "control".
        first: the row whose share is counted; in a control with its own sound.
        second: the other row; in a control the same one with another clip's sound.
        answers: number of them.
        same: answers that saw no difference; they count half for either.
        share: part of the answers that preferred the first, 0 to 1.
        interval: 95 % of it, from drawings of participants; None where there is but one.
    """

    question: str
    kind: str
    first: str
    second: str
    answers: int
    same: int
    share: float
    interval: tuple[float, float] | None


def count_answers(study: Path, answers: Path, seed: int = 0) -> list[Count]:
    """Count the answers to a study.

    Args:
        study: folder that `make_study` made.
        answers: folder with the files that participants sent, `*.json`.
        seed: of the drawings.

    Raises:
        BadInput: no study, no answers, or answers to another study.
    """
    try:
        key = json.loads((Path(study) / KEY).read_text())
        pairs = {entry["number"]: entry for entry in key["pairs"]}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BadInput(
            f"{study}: is not a study (no {KEY}); angie study REPORT -o STUDY"
        ) from error
    said: dict[tuple[str, ...], dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for participant, pair, answer in _answers(Path(answers), key["study"], pairs):
        first, second = pair["first"], pair["second"]
        chosen = answer["choice"] == "left"
        value = 0.5 if answer["choice"] == "same" else float(
            chosen == (answer["left"] == first["video"])
        )  # fmt: skip
        group = (answer["question"], pair["kind"], first["row"], second["row"])
        said[group][participant].append(value)
    random = np.random.default_rng(seed)
    order = {question: place for place, question in enumerate(QUESTIONS)}
    groups = sorted(said, key=lambda group: (order[group[0]], group[1] == CONTROL))
    return [_counted(group, list(said[group].values()), random) for group in groups]


def _answers(
    folder: Path, study: str, pairs: Mapping[int, Any]
) -> Iterator[tuple[str, Any, dict[str, Any]]]:
    """Participant, pair and answer, one after the other."""
    files = sorted(folder.glob("*.json"))
    if not files:
        raise BadInput(f"{folder}: holds no answers (*.json)")
    seen: dict[str, Path] = {}
    for path in files:
        try:
            given = json.loads(path.read_text(encoding="utf-8"))
            participant = str(given["participant"])
            if given["study"] != study:
                raise BadInput(f"{path}: answers to another study")
            if participant in seen:
                raise BadInput(f"{path}: the answers of {seen[participant].name} once more")
            seen[participant] = path
            for answer in given["answers"]:
                pair = pairs[answer["pair"]]
                videos = (pair["first"]["video"], pair["second"]["video"])
                known = answer["question"] in QUESTIONS and answer["choice"] in CHOICES
                if not known or answer["left"] not in videos:
                    raise ValueError("an answer to no question")
                yield participant, pair, answer
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise BadInput(f"{path}: not the answers of a participant ({error})") from error


def _counted(
    group: tuple[str, ...], values: list[list[float]], random: np.random.Generator
) -> Count:
    question, kind, first, second = group
    every = np.concatenate(values)
    interval = None
    if len(values) > 1:
        sums = np.array([sum(one) for one in values])
        sizes = np.array([len(one) for one in values])
        drawn = random.integers(len(values), size=(RESAMPLES, len(values)))
        shares = sums[drawn].sum(1) / sizes[drawn].sum(1)
        low, high = np.quantile(shares, [0.025, 0.975])
        interval = (float(low), float(high))
    same = int((every == 0.5).sum())
    return Count(question, kind, first, second, len(every), same, float(every.mean()), interval)


def in_words(counts: Sequence[Count]) -> str:
    """A line for each count."""
    lines = []
    for one in counts:
        pair = f"{one.first} over {one.second}"
        if one.kind == CONTROL:
            pair = f"{one.first}, own sound over another's"
        half = "one participant, no interval"
        if one.interval is not None:
            half = f"95 % interval {100 * one.interval[0]:.0f} to {100 * one.interval[1]:.0f} %"
        lines.append(
            f"{one.question:10} {pair}: {100 * one.share:.0f} % ({half}; {one.answers} answers, "
            f"{one.same} without a difference)"
        )
    return "\n".join(lines)
