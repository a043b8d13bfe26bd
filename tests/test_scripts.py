"""The scripts: each tells what it is for, and what is given wrongly in one line."""

import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

SCRIPTS = Path(__file__).parent.parent / "scripts"


@pytest.fixture
def run(monkeypatch, capsys):
    """Exit status, standard output and standard error of a script."""

    def call(name, *arguments):
        monkeypatch.syspath_prepend(str(SCRIPTS))  # as for any script that Python is given
        monkeypatch.setattr(sys, "argv", [str(SCRIPTS / name), *map(str, arguments)])
        with pytest.raises(SystemExit) as leave:
            runpy.run_path(str(SCRIPTS / name), run_name="__main__")
        return leave.value.code, *capsys.readouterr()

    return call


WITH_COMMAND = sorted(p.name for p in SCRIPTS.glob("*.py") if "__main__" in p.read_text())


@pytest.mark.parametrize("name", WITH_COMMAND)
def test_every_script_has_help(run, name):
    status, out, err = run(name, "--help")
    assert status == 0 and err == ""
    assert out.startswith(f"usage: {name}") and len(out.splitlines()) > 4


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["bench_frames.py", "{tmp}"], "dataset.json"),
        (["bench_angie.py", "0"], "above 0"),
        (["ship_default.py", "{tmp}"], "not a speaker bundle"),
        (["refit_renderer.py", "{tmp}/none.safetensors", "{tmp}/out"], "none.safetensors: not the"),
        (["refit_renderer.py", "{tmp}/text", "{tmp}/out"], "text: not the weights"),
        (["compare_renderers.py", "{tmp}", "{tmp}/out", "--only", "lap,depe"], "--only depe: "),
        (["compare_renderers.py", "{tmp}", "{tmp}/out"], "dataset.json"),
        (["check_regions.py", "{tmp}", "{tmp}", "{tmp}"], "dataset.json"),
        (["check_drift.py", "{tmp}", "{tmp}"], "dataset.json"),
    ],
)
def test_bad_input_of_a_script_is_one_line(run, tmp_path, arguments, words):
    (tmp_path / "text").write_text("no weights")
    given = [argument.format(tmp=tmp_path) for argument in arguments]
    status, out, err = run(*given)
    assert status == 2 and out == "" and err.startswith(f"{given[0]}: ")
    assert words in err and err.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["text"]


def test_truth_of_other_videos_is_told(run, dataset, bundle, tmp_path):
    status, out, err = run("check_regions.py", tmp_path, dataset.path, bundle.folder)
    assert status == 2 and out == "" and err.count("\n") == 1
    assert "holds the truth (*.truth.npz) of no clip" in err
    status, _, err = run("check_regions.py", tmp_path, dataset.path, bundle.folder, "--stride", "0")
    assert status == 2 and "no test frames are left" in err
    assert list(tmp_path.iterdir()) == []


def test_faults_are_of_the_present_sources():
    """Each is one line that stands in its file exactly once, and some test is aimed at it."""
    faults = yaml.safe_load((SCRIPTS / "faults.yaml").read_text())
    assert len({fault["name"] for fault in faults}) == len(faults) >= 40
    for fault in faults:
        assert (SCRIPTS.parent / fault["file"]).read_text().count(fault["old"]) == 1, fault["name"]
        assert fault["tests"] and all((SCRIPTS.parent / test).exists() for test in fault["tests"])


def test_fields_of_one_code_are_compared_over_photos_and_of_one_photo_over_codes(monkeypatch):
    monkeypatch.syspath_prepend(str(SCRIPTS))
    check = runpy.run_path(str(SCRIPTS / "check_codes_angie.py"))
    random = np.random.default_rng(0)
    codes = random.normal(size=(1, 3, 4, 5, 2)).repeat(2, 0)  # two photos on which codes act alike
    found = check["compare"](codes * [[[[[1.0]]]], [[[[2.0]]]]] + 0.5)
    assert found["same code"] == pytest.approx([1.0] * 3) and len(found["same photo"]) == 6
    assert max(map(abs, found["same photo"])) < 0.6
    assert check["correlation"](codes[0, 0], -codes[0, 0]) == pytest.approx(-1)
    assert check["correlation"](codes[0, 0], 0 * codes[0, 0]) == 0


def test_photos_are_taken_from_the_nearest_to_rest_to_the_farthest(monkeypatch):
    monkeypatch.syspath_prepend(str(SCRIPTS))
    check = runpy.run_path(str(SCRIPTS / "check_poses.py"))
    assert check["sources"](np.array([3.0, 1.0, 2.0, 9.0, 5.0]), 3) == [1, 0, 3]
    trial = check["Trial"]
    trials = [
        trial(d, 5.0 - d, 2 * d, d, -d, float("nan") if d == 1 else d) for d in (4, 1, 3, 2.0)
    ]
    lines = check["table"](trials, 2)
    assert lines[1].split() == ["1.5000", "3.5000", "3.0000", "1.5000", "-1.5000", "2.0000"]
    assert "l1 +1.00" in lines[-1] and "outside -1.00" in lines[-1] and "bc +1.00" in lines[-1]
