"""A fast sample of scripts/fuzz.py and scripts/check_sync.py."""

import os
import pickle
import signal
import sys
from pathlib import Path

import numpy as np
import pytest

SCRIPTS = Path(__file__).resolve().parents[1] / "scripts"


@pytest.fixture
def scripts(monkeypatch):
    monkeypatch.syspath_prepend(str(SCRIPTS))
    yield
    for name in ("fuzz", "check_sync", "fuzzing", "fuzzing.mutations", "fuzzing.targets"):
        sys.modules.pop(name, None)


KINDS = (
    "photo png",
    "photo jpg",
    "sound wav",
    "sound mp3",
    "transcript json",
    "PATS table",
    "words",
)


def test_spoilt_files_are_told_in_one_line(scripts, tmp_path, monkeypatch):
    import fuzz

    monkeypatch.chdir(tmp_path)
    targets = {name: fuzz.LIGHT[name] for name in KINDS}
    outcomes = list(fuzz.Fuzzer(targets, tmp_path / "work", 11).run(range(60)))
    assert len(outcomes) == 60
    assert [outcome for outcome in outcomes if outcome.fault] == []
    assert {outcome.kind for outcome in outcomes} == {"used", "refused"}


def test_a_careless_reader_is_found_out(scripts, tmp_path, monkeypatch):
    import fuzz
    from fuzzing.mutations import MARK, Payload

    contents = [pickle.dumps(Payload(tmp_path / MARK)), b"death", b"noise", b"bug", b"whole"]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(fuzz, "spoil", lambda path, rng: path.write_bytes(contents.pop(0)))

    def make(folder: Path) -> list[Path]:
        (folder / "a.txt").write_text("whole")
        return [folder / "a.txt"]

    def read(folder: Path) -> None:
        match (folder / "a.txt").read_bytes():
            case b"death":
                os.kill(os.getpid(), signal.SIGKILL)
            case b"noise":
                os.write(2, b"libpng warning")
            case b"bug":
                raise KeyError("bug")
            case b"whole":
                pass
            case data:
                pickle.loads(data)

    fuzzer = fuzz.Fuzzer({"careless": fuzz.Target(make, read)}, tmp_path / "work", 0)
    kinds = []
    for case in range(5):
        kinds += [outcome.kind for outcome in fuzzer.run(range(case, case + 1))]
        contents.pop(0)  # what the child took
        (tmp_path / MARK).rmdir() if (tmp_path / MARK).exists() else None
    assert kinds == ["a trace", "crash", "noise", "traceback", "used"]


@pytest.mark.parametrize("number", range(9))
def test_sound_and_picture_stay_together(scripts, tmp_path, number):
    import check_sync

    case = check_sync.random_case(np.random.default_rng(number), number, 1.5)
    result = check_sync.measure(case, tmp_path)
    assert result.good, f"{case}: {result}"
