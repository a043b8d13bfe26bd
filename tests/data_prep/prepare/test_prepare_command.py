"""The options of `angie prepare`: what they mean, and one line for what they cannot mean."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from angie.cli import app
from data_prep.errors import BadInput

RUN = CliRunner()


def fail(*arguments: str) -> str:
    result = RUN.invoke(app, ["prepare", "-o", "out", *arguments])
    assert isinstance(result.exception, BadInput)
    assert "\n" not in str(result.exception)
    return str(result.exception)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ([], "no video given"),
        (["a.mp4"], "a.mp4: no such file"),
        (["a.mp4", "--crop", "1,2,300,301"], "is not a square"),
        (["a.mp4", "--crop", "1,2"], "give x,y,size"),
        (["a.mp4", "--crop", "1,2,0"], "above 0"),
        (["a.mp4", "--crop", "1,2,3,4,5"], "give x,y,size"),
        (["a.mp4", "--person", "middle"], "choose from left, right, largest"),
        (["a.mp4", "--shortest", "9"], "twice --shortest"),
        (["a.mp4", "--longest", "nan"], "twice --shortest"),
        (["a.mp4", "--add", "--force"], "give one"),
        (["a.mp4", "--pats", "none.csv"], "none.csv: no such file"),
    ],
)
def test_bad_options(
    arguments: list[str], told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert told in fail(*arguments)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("crop", ["10,20,300", "10,20,300,300"])
def test_a_crop_may_have_three_numbers_or_four(
    crop: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.mp4").write_text("no video")
    assert "nothing of the videos can be used: a.mp4: not a rec" in fail("a.mp4", "--crop", crop)
    assert [path.name for path in tmp_path.iterdir()] == ["a.mp4"]
