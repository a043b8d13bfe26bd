"""Tables as spreadsheets of any country save them."""

import pytest

from data_prep.errors import BadInput
from data_prep.table import number, read_table

ROWS = [{"clip": "a, the first", "fps": "12,5"}, {"clip": "b;c", "fps": "25"}]


@pytest.mark.parametrize("mark", [",", ";", "\t", "|"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_any_separator_encoding_and_line_end(tmp_path, mark, encoding, end):
    lines = [["Clip ", "other", "FPS"], ['"a, the first"', "é", '"12,5"'], ['"b;c"', '"x"', " 25"]]
    text = end.join([*(mark.join(line) for line in lines), mark * 2, ""])
    (tmp_path / "a.csv").write_bytes(text.encode(encoding))
    rows = read_table(tmp_path / "a.csv", ("clip", "fps"))
    assert [{name: row[name] for name in ("clip", "fps")} for row in rows] == ROWS
    assert rows[0]["other"] == "é"
    assert [number(row["fps"]) for row in rows] == [12.5, 25.0]


def test_the_line_for_excel_and_short_rows(tmp_path):
    (tmp_path / "a.csv").write_bytes(b"sep=;\r\nclip;fps\r\na\r\n")
    assert read_table(tmp_path / "a.csv", ("clip", "fps")) == [{"clip": "a", "fps": ""}]


def test_what_is_missing_is_named(tmp_path):
    (tmp_path / "a.csv").write_text("clip,rate\n")
    with pytest.raises(BadInput, match="needs the columns clip, fps, and has no fps"):
        read_table(tmp_path / "a.csv", ("clip", "fps"))
    with pytest.raises(BadInput, match="and has no link"):
        read_table(tmp_path / "a.csv", ("clip",), one_of=("link", "file"))
    for content in (b"", b"\x81\x8d\xff" * 9, b"\0" * 50):
        (tmp_path / "a.csv").write_bytes(content)
        with pytest.raises(BadInput):
            read_table(tmp_path / "a.csv", ("clip",))
    with pytest.raises(BadInput, match="no such file"):
        read_table(tmp_path / "none.csv", ("clip",))


def test_numbers_with_a_comma():
    assert number("1,5") == number("1.5") == 1.5
    with pytest.raises(ValueError):
        number("1,234.5")
