"""The notebook runs from its top to its bottom."""

import json
from pathlib import Path

import pytest

NOTEBOOK = Path(__file__).parent.parent / "notebooks" / "first_steps.ipynb"


def cells():
    told = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    return ["".join(cell["source"]) for cell in told["cells"] if cell["cell_type"] == "code"]


def test_every_cell_is_python_without_stored_output():
    told = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    assert all(not cell.get("outputs") for cell in told["cells"])
    for number, text in enumerate(cells()):
        compile(text, f"cell {number}", "exec")


@pytest.mark.slow
def test_the_notebook_runs(tmp_path, monkeypatch, capsys):
    pytest.importorskip("IPython")
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    for number, text in enumerate(cells()):
        exec(compile(text, f"cell {number}", "exec"), names)
    made = {path.name for path in tmp_path.iterdir()}
    wanted = {"first.mp4", "sheet.png", "motion.npz", "other.gif", "take0.mp4", "take1.mp4"}
    assert wanted <= made and "never.mp4" not in made
    told = capsys.readouterr().out
    assert "stopped; False" in told and "2 made, 0 there already, 0 failed" in told
