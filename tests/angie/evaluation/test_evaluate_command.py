"""`angie evaluate`: bad input is one line and exit status 2, and leaves nothing behind."""

import json
import sys

import pytest

from angie.cli import main


def call(capsys, *arguments):
    """Exit status, standard output and standard error of `angie evaluate ARGUMENTS`."""
    status = 0
    old, sys.argv = sys.argv, ["angie", "evaluate", *map(str, arguments)]
    try:
        main()
    except SystemExit as leave:
        status = leave.code or 0
    finally:
        sys.argv = old
    captured = capsys.readouterr()
    return status, captured.out, captured.err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["{data}", "{bundle}"], "--output"),
        (["{data}", "-o", "{tmp}/out"], "DATASET BUNDLE"),
        (["-o", "{tmp}/out"], "DATASET BUNDLE"),
        (["{data}", "{bundle}", "{bundle}", "-o", "{tmp}/out"], "named twice"),
        (["{tmp}", "{bundle}", "-o", "{tmp}/out"], "is not a dataset"),
        (["{data}", "{data}", "-o", "{tmp}/out"], "not a speaker bundle"),
        (["{data}", "{bundle}", "-o", "{tmp}/taken"], "exists already"),
        (["{data}", "{bundle}", "-o", "{tmp}/taken", "--force"], "holds other things"),
        (["{data}", "{bundle}", "-o", "{data}", "--force"], "would replace the input"),
        (["{data}", "{bundle}", "-o", "{tmp}/out", "--start", "zero"], "choose from truth, pose"),
        (["{data}", "{bundle}", "-o", "{tmp}/out", "--fgd", "{tmp}/none"], "no such file"),
        (["{data}", "{bundle}", "-o", "{tmp}/out", "--models", "{tmp}/none"], "no such folder"),
        (["-o", "{tmp}/out", "--models", "{tmp}", "--no-images"], "give one"),
        (["-o", "{tmp}/out", "--models", "{tmp}", "--videos", "{tmp}"], "DATASET BUNDLE"),
        (
            ["{data}", "{bundle}", "-o", "{tmp}/out", "--fgd", "{tmp}/taken/text"],
            "not an autoencoder",
        ),
        (["{data}", "{bundle}", "-o", "{tmp}/out", "--truth", "{tmp}"], "truth"),
        (["{data}", "{bundle}", "-o", "{tmp}/out", "--reference", "{data}"], "--videos"),
        (["--videos", "{tmp}", "-o", "{tmp}/out"], "--reference"),
        (["{data}", "--videos", "{tmp}", "-o", "{tmp}/out"], "takes no DATASET"),
        (["--videos", "{tmp}/none", "--reference", "{data}", "-o", "{tmp}/out"], "not a folder"),
    ],
)
def test_bad_input_is_one_line(dataset, bundle, tmp_path, capsys, arguments, words):
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "text").write_text("keep me")
    given = [a.format(data=dataset.path, bundle=bundle.folder, tmp=tmp_path) for a in arguments]
    status, out, err = call(capsys, *given)
    assert status == 2 and out == "" and words in err and err.count("\n") == 1, err
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]


def test_the_table_is_printed(dataset, bundle, tmp_path, capsys):
    output = tmp_path / "report"
    status, out, err = call(
        capsys,
        *(dataset.path, bundle.folder, "-o", output),
        *("--no-images", "--fgd-steps", 2, "--seed", 3),
    )
    assert status == 0 and "ground truth" in out and "mismatched" in out
    assert out.endswith(f"{output}: report.html, table.csv, results.json\n")
    assert "note: FGD: " in err
    assert json.loads((output / "results.json").read_text())["options"]["seed"] == 3
