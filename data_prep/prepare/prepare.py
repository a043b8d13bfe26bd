"""From videos of speakers to a dataset: `angie prepare`."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from data_prep.cluster import spread_on_ray
from data_prep.dataset import FORMAT, MANIFEST, TABLE, Dataset, write_table
from data_prep.errors import BadInput
from data_prep.files import check_apart, sha256
from data_prep.prepare.ingest import Order, died, make_source
from data_prep.prepare.pats import (
    MISSING,
    not_kept,
    pats_sources,
    read_intervals,
    read_missing,
    write_missing,
)
from data_prep.prepare.record import Record, key_of, read_records, write_json
from data_prep.prepare.report import write_report
from data_prep.prepare.source import (
    IngestionConfig,
    Source,
    find_sources,
    name_sources,
    named_by,
    names_pattern,
)
from data_prep.prepare.split import BY_PERSON, BY_SOURCE, split_clips
from data_prep.prepare.summary import Summary
from data_prep.prepare.workplace import Workplace, check_place, making, workplace
from data_prep.processes import spread
from data_prep.progress import progress
from data_prep.rates import FPS, IMAGE_SIZE, SAMPLE_RATE
from data_prep.speaker.networks import FACE, load_network
from data_prep.speech.transcript import find_transcript

_MESSAGE_REASONS = 3


@dataclass(frozen=True)
class _Found:
    """A source with the hash of its content, "" where it cannot be read."""

    source: Source
    sha256: str


def prepare(
    videos: Sequence[Path],
    output: Path,
    *,
    speaker: str | None = None,
    names: str | None = None,
    jobs: int = 1,
    config: IngestionConfig | None = None,
    models: Path | None = None,
    pats: Path | None = None,
    add: bool = False,
    force: bool = False,
    ray: str | None = None,
) -> Summary:
    """Turn videos of speakers into a dataset of square clips with sound and features.

    A video that cannot be used is listed with the reason and the others go on. A run that was
    killed is continued by the next one with the same output: what is done is not done again.
    The same call on a finished dataset makes the videos that have come since, and nothing else.

    Args:
        videos: files, or folders that are searched through all their levels.
        output: the dataset to write; it appears when it is whole.
        speaker: who speaks in all of them; None takes the folders' or files' names. With `pats`
            the one speaker whose intervals are cut.
        names: where the names of the files tell who is seen and whose way of gesturing it is, see
            `names_pattern`.
        jobs: processes.
        config: how clips are made; None for the defaults.
        models: folder of networks (`data_prep.speaker.networks`), whose one for faces is used;
            None finds them by the cascades alone.
        pats: table of intervals of the PATS dataset; only these are cut.
        add: keep what a dataset at `output` holds, and make only what is new or has changed.
        force: replace an existing dataset.
        ray: address of a cluster that makes the clips (`data_prep.cluster`), in place of `jobs`.

    Raises:
        BadInput: no such video, an output that cannot be written or that holds what this call
            would not make (and neither `add` nor `force`), or nothing was kept.
    """
    output, config = Path(output).resolve(), config or IngestionConfig()
    if models is not None:
        load_network(models, FACE)
        config = replace(config, face_network=sha256(models / FACE.file))
    if output.exists():
        check_apart(output, videos)
    check_place(output)
    there = output.exists()
    dataset = Dataset(output) if there and not force else None
    present = {} if dataset is None else _present(dataset)
    intervals, missing = read_intervals(pats, speaker) if pats is not None else ([], [])
    if pats is None:
        sources = find_sources(videos, speaker)
        sources = sources if names is None else named_by(names_pattern(names), sources)
    else:
        sources, absent = pats_sources(intervals, videos)
        missing += absent
    found, doubles = _settle_names(_hash(sources, jobs), present)
    orders = [_order(entry, config, models, output) for entry in found]
    wanted = {name: record.key for name, record in present.items()}
    wanted.update((order.source.name, order.key) for order in orders)
    if dataset is not None and not add:
        _check_same(output, present, orders)
    with workplace(output, replace=there) as place:
        place.settle(wanted, None if dataset is None else output)
        done_before = _make(orders, place, jobs, ray)
        records = [place.records[name] for name in sorted(place.records)]
        if not any(record.clips for record in records):
            raise BadInput(_nothing_kept(records))
        if pats is not None:
            wanted_now = {order.source.name for order in orders}
            missing += not_kept(intervals, [r.outcome for r in records if r.name in wanted_now])
        summary = Summary(
            path=output,
            records=tuple(records),
            split=split_clips([c for r in records for c in r.clips], _splits_before(dataset)),
            doubles=tuple(doubles),
            missing=None if pats is None else tuple(missing),
            before={} if dataset is None else {c.id: c.split for c in dataset.clips()},
            done_before=done_before,
        )
        _write(place.folder, summary, dataset)
    return summary


def _make(orders: list[Order], place: Workplace, jobs: int, ray: str | None) -> int:
    """Make the sources that no earlier run has made; the number of those that it had."""
    todo = [order for order in orders if order.source.name not in place.records]
    done = len(orders) - len(todo)
    with progress("prepare", len(orders), "videos", done) as advance:
        made = spread(make_source, todo, jobs)
        if ray is not None and todo:
            made = spread_on_ray(make_source, todo, ray)
        for order, record in made:
            place.put(record or died(order))
            advance(1, note=order.source.name)
    return done


def _present(dataset: Dataset) -> dict[str, Record]:
    """Records of a finished dataset that shall be added to."""
    records = read_records(dataset.path)
    lost = [s["name"] for s in dataset.manifest["sources"] if s["name"] not in records]
    if lost:
        raise BadInput(
            f"{dataset.path}: cannot be added to, its files of {lost[0]} are damaged or of an "
            "older angie; prepare all the videos again with --force"
        )
    return records


def _check_same(output: Path, present: dict[str, Record], orders: list[Order]) -> None:
    """Refuse to touch a dataset unless all that it holds would be made the same way now."""
    keys = {order.source.name: order.key for order in orders}
    for name, record in present.items():
        if record.key and keys.get(name) != record.key:
            why = "was made otherwise" if name in keys else "is not among these videos"
            raise BadInput(
                f"{output}: exists already, and {name} in it {why}; "
                "--add keeps what it holds, --force replaces it"
            )


def _hash(sources: list[Source], jobs: int) -> list[_Found]:
    def found(source: Source) -> _Found:
        try:
            return _Found(source, sha256(source.path) if source.path.stat().st_size else "")
        except OSError:
            return _Found(source, "")  # its record will say why

    with ThreadPoolExecutor(max(1, min(jobs, 8))) as threads:
        return list(threads.map(found, sources))


def _settle_names(
    found: list[_Found], present: dict[str, Record]
) -> tuple[list[_Found], list[tuple[Path, Path]]]:
    """Name the sources: those that are known by their content keep the name that they have.

    Returns:
        the sources, each content once; and the doubles, with the file that counts.
    """
    first: dict[Any, Path] = {}
    single: list[_Found] = []
    doubles: list[tuple[Path, Path]] = []
    for entry in found:
        what = (entry.sha256 or entry.source.path, entry.source.intervals)
        if what in first:
            doubles.append((entry.source.path, first[what]))
        else:
            first[what] = entry.source.path
            single.append(entry)
    known = {_identity(r.outcome.sha256, r.outcome.source): name for name, r in present.items()}
    sources = name_sources(
        [replace(e.source, name=known.get(_identity(e.sha256, e.source), "")) for e in single],
        taken=present,
    )
    return [replace(e, source=s) for e, s in zip(single, sources, strict=True)], doubles


def _identity(content: str, source: Source) -> tuple[str, str]:
    return content or source.path.name, source.speaker


def _order(found: _Found, config: IngestionConfig, models: Path | None, output: Path) -> Order:
    source = found.source
    transcript = find_transcript(source.path)
    identity = ""
    if transcript is not None:
        try:
            identity = transcript.name[len(source.path.stem) :] + sha256(transcript)
        except OSError as error:
            identity = f"{transcript.name}: {error.strerror}"
    key = key_of(source, found.sha256, identity, config)
    return Order(source, found.sha256, key, config, transcript, making(output, source.name), models)


def _splits_before(dataset: Dataset | None) -> dict[str, str]:
    """Splits of the sources that a dataset divided by source."""
    if dataset is None:
        return {}
    rules = dataset.manifest["splits"]
    whole = (BY_SOURCE, BY_PERSON)
    return {c.source: c.split for c in dataset.clips() if rules.get(c.speaker) in whole}


def _nothing_kept(records: list[Record]) -> str:
    reasons = [
        f"{r.outcome.source.path.name}: {r.outcome.refused}" for r in records[:_MESSAGE_REASONS]
    ]
    more = len(records) - len(reasons)
    return "nothing of the videos can be used: " + "; ".join(
        reasons + ([f"and {more} more"] if more > 0 else [])
    )


def _write(folder: Path, summary: Summary, dataset: Dataset | None) -> None:
    """Write the files that describe all sources together."""
    write_table(folder / TABLE, summary.split.clips, FPS)
    missing = list(summary.missing or ())
    if dataset is not None and (dataset.path / MISSING).exists():
        now = {entry.interval.speaker for entry in missing}
        missing += [
            m for m in read_missing(dataset.path / MISSING) if m.interval.speaker not in now
        ]
    if missing or summary.missing is not None:
        write_missing(folder / MISSING, missing)
    write_report(folder, summary)
    write_json(folder / MANIFEST, _manifest(summary))


def _manifest(summary: Summary) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "fps": FPS,
        "size": IMAGE_SIZE,
        "sample_rate": SAMPLE_RATE,
        "splits": summary.split.rules,
        "sources": [_manifest_entry(record) for record in summary.records],
    }


def _manifest_entry(record: Record) -> dict[str, Any]:
    outcome = record.outcome
    used = next((s.crop for s in outcome.spans if s.reason is None and s.crop is not None), None)
    return {
        "name": record.name,
        "file": outcome.source.path.name,
        "sha256": outcome.sha256,
        "speaker": outcome.source.speaker,
        "person": outcome.source.person,
        "video": None if outcome.info is None else asdict(outcome.info),
        "settings": asdict(record.config),
        "crop": None if used is None else asdict(used),
        "spans": [asdict(span) for span in outcome.spans],
        "clips": len(record.clips),
        "seconds": round(sum(clip.n_frames for clip in record.clips) / FPS, 2),
        "dropped": {reason: round(s, 2) for reason, s in sorted(outcome.dropped.items())},
        "refused": outcome.refused,
        "words": record.words,
        "warnings": list(record.warnings),
    }
