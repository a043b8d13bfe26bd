"""The folder in which a dataset grows: a killed run leaves it, and the next one goes on there."""

import errno
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from data_prep.dataset import MANIFEST, TABLE
from data_prep.errors import BadInput
from data_prep.files import LOCK, check_output, locked
from data_prep.prepare.clips import FOLDERS
from data_prep.prepare.record import (
    RECORDS,
    Record,
    files_of,
    read_records,
    record_path,
    sheet_path,
    write_record,
)

EXTRAS = ("report.html", "report.json", "pats_missing.csv")
"""What a run writes besides clips, records, table and manifest."""

LEAST_ROOM = 4 << 20
"""Bytes that must be free for a failure not to be the disk's."""

_MAKING = ".making"
"""Folder of what is being made and belongs to no source yet."""


class Workplace:
    """The folder `.NAME.part` beside a dataset NAME; made by `workplace`.

    Sources are made in folders of their own and put into place by a single process: first the
    files, then the record. So what has a record is whole, and what has none is swept away.

    Attributes:
        folder: laid out as the dataset will be.
        records: of the sources that are done, by name.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        for name in (*FOLDERS, RECORDS):
            (folder / name).mkdir(parents=True, exist_ok=True)
        self.records = read_records(folder)

    def settle(self, wanted: Mapping[str, str], dataset: Path | None = None) -> None:
        """Bring the folder to what this run builds on: the records wanted that are there.

        Args:
            wanted: key of each source that the dataset will have, by name.
            dataset: a finished one, from which sources are taken over as they are.
        """
        for name in list(self.records):
            if self.records[name].key != wanted.get(name):
                self._forget(name)
        self._sweep()
        if dataset is not None:
            for record in read_records(dataset).values():
                if record.name not in self.records and record.key == wanted.get(record.name):
                    self._adopt(dataset, record)
            self._adopt_strangers(dataset)

    def _sweep(self) -> None:
        """Remove every file that belongs to no source, as a killed run leaves them."""
        known = {path for record in self.records.values() for path in record.files}
        for path in files_of(self.folder):
            if path not in known:
                (self.folder / path).unlink()
        for file in (self.folder / RECORDS).iterdir():
            if file.stem not in self.records or file.suffix not in (".json", ".jpg"):
                file.unlink()
        shutil.rmtree(self.folder / _MAKING, ignore_errors=True)

    def _adopt(self, dataset: Path, record: Record) -> None:
        for path in record.files:
            _link(dataset / path, self.folder / path)
        if record.sheet:
            _link(sheet_path(dataset, record.name), sheet_path(self.folder, record.name))
        _link(record_path(dataset, record.name), record_path(self.folder, record.name))
        self.records[record.name] = record

    def _adopt_strangers(self, dataset: Path) -> None:
        """Take over what others have put into the dataset."""
        own = {*FOLDERS, RECORDS, MANIFEST, TABLE, *EXTRAS}
        for path in sorted(dataset.rglob("*")):
            inside = path.relative_to(dataset)
            if path.is_file() and inside.parts[0] not in own:
                (self.folder / inside).parent.mkdir(parents=True, exist_ok=True)
                _link(path, self.folder / inside)

    def put(self, record: Record) -> None:
        """Move the files of a source from where it was made into place, its record last."""
        self._forget(record.name)
        source = self.folder / _MAKING / record.name
        for path in record.files:
            os.replace(source / path, self.folder / path)
        if record.sheet:
            os.replace(source / "sheet.jpg", sheet_path(self.folder, record.name))
        write_record(self.folder, record)
        self.records[record.name] = record
        shutil.rmtree(source, ignore_errors=True)

    def _forget(self, name: str) -> None:
        record_path(self.folder, name).unlink(missing_ok=True)
        sheet_path(self.folder, name).unlink(missing_ok=True)
        if record := self.records.pop(name, None):
            for path in record.files:
                (self.folder / path).unlink(missing_ok=True)


def _link(source: Path, target: Path) -> None:
    target.unlink(missing_ok=True)
    try:
        os.link(source, target)
    except OSError:  # a file system without hard links
        part = target.with_name(f".{target.name}.part")
        shutil.copyfile(source, part)
        os.replace(part, target)


def _part(output: Path) -> Path:
    return output.with_name(f".{output.name}.part")


def _old(output: Path) -> Path:
    return output.with_name(f".{output.name}.old")


def making(output: Path, name: str) -> Path:
    """The folder in which a source of a dataset is made."""
    return _part(output) / _MAKING / name


def check_place(output: Path) -> None:
    """Refuse an output where no dataset can be made, before any work is done for it.

    Raises:
        BadInput: it is there already and no dataset, or it cannot be written.
    """
    old = _old(output)
    if old.exists() and not output.exists():  # killed between the two moves at the end
        os.replace(old, output)
    check_output(output, force=True)
    if output.exists() and not (output / MANIFEST).is_file():
        raise BadInput(f"{output}: holds other things (no {MANIFEST}); name a new folder")


@contextmanager
def workplace(output: Path, *, replace: bool) -> Iterator[Workplace]:
    """Yield the place in which a dataset is made; it becomes `output` if the block succeeds.

    After `BadInput` nothing is left of it. After any other interruption it stays, and the next
    call goes on with it.

    Args:
        output: the dataset.
        replace: one that is there may be replaced.

    Raises:
        BadInput: as `check_place`, or another run is making it, or has made it meanwhile.
    """
    output = Path(output).resolve()
    check_place(output)
    if output.exists() and not replace:
        raise BadInput(f"{output}: another run has just made it; look at it and run this again")
    part, old = _part(output), _old(output)
    part.mkdir(exist_ok=True)
    useless: BadInput | None = None
    with locked(part, output):
        shutil.rmtree(old, ignore_errors=True)
        try:
            yield Workplace(part)
        except BadInput as error:
            useless = error
    if useless is not None:
        shutil.rmtree(part, ignore_errors=True)
        raise useless
    _move(part, output, old)


def _move(part: Path, output: Path, old: Path) -> None:
    shutil.rmtree(part / _MAKING, ignore_errors=True)
    (part / LOCK).unlink(missing_ok=True)
    if output.exists():
        os.replace(output, old)
        os.replace(part, output)
        shutil.rmtree(old, ignore_errors=True)
    else:
        os.replace(part, output)


def check_room(folder: Path) -> None:
    """Stop where a disk is full: whatever failed there failed of it.

    Raises:
        OSError: less than `LEAST_ROOM` is free.
    """
    if shutil.disk_usage(folder).free < LEAST_ROOM:
        what = "no space is left on the disk; make room and repeat the command, it goes on there"
        raise OSError(errno.ENOSPC, what, str(folder))
