"""Tables that people edit: comma separated values, as spreadsheets of any country save them."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path

from data_prep.errors import BadInput
from data_prep.media.container import check_file

_SEPARATORS = ",;\t|"


def decode_text(data: bytes) -> str:
    """Text in UTF-8 or UTF-16, with or without a mark at its beginning, or else in Windows' code.

    Raises:
        UnicodeDecodeError: in none of them.
    """
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="strict")


def read_table(
    path: Path, needed: Sequence[str], advice: str = "", one_of: Sequence[str] = ()
) -> list[dict[str, str]]:
    """Rows of a table, by the names of its columns.

    Columns are separated by whatever gives the most of the names that are needed: a spreadsheet
    writes semicolons where the comma is in the numbers, and tabs as "Unicode text". Blanks around
    names and values do not count, nor does the case of names, nor empty rows.

    Args:
        path: the table; it may have more columns, in any order.
        needed: names of columns.
        advice: what to do where one is missing.
        one_of: further columns, of which there must be one.

    Raises:
        BadInput: not readable, or a column missing.
    """
    check_file(path)
    try:
        lines = decode_text(Path(path).read_bytes()).splitlines(keepends=True)
        if lines and lines[0].strip().lower() in {f"sep={mark}" for mark in ",;|"} | {"sep="}:
            lines = lines[1:]  # which tells Excel the separator
        wanted = {name.lower(): name for name in (*needed, *one_of)}
        heads = {mark: _names(list(csv.reader(lines[:1], delimiter=mark))) for mark in _SEPARATORS}
        mark = max(_SEPARATORS, key=lambda mark: len(wanted.keys() & heads[mark]))
        rows = list(csv.reader(io.StringIO("".join(lines), newline=""), delimiter=mark))
    except OSError as error:
        raise BadInput(f"{path}: cannot be read as a table ({error.strerror})") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise BadInput(f"{path}: cannot be read as a table ({error})") from error
    found = _names(rows)
    lacking = [name for name in needed if name.lower() not in found]
    if one_of and not any(name.lower() in found for name in one_of):
        lacking.append(one_of[0])
    if lacking:
        what = f"needs the columns {', '.join(needed)}, and has no {', '.join(lacking)}"
        raise BadInput(f"{path}: {what}{advice}")
    names = [wanted.get(name.strip().lower(), name.strip()) for name in rows[0]]
    filled = [
        [*row, *[""] * (len(names) - len(row))] for row in rows[1:] if any(map(str.strip, row))
    ]
    return [dict(zip(names, map(str.strip, row), strict=False)) for row in filled]


def _names(rows: list[list[str]]) -> set[str]:
    return {name.strip().lower() for name in rows[0]} if rows else set()


def number(text: str) -> float:
    """A number, with a point or a comma before its fraction.

    Raises:
        ValueError: no number.
    """
    return float(text.replace(",", ".") if text.count(",") == 1 and "." not in text else text)
