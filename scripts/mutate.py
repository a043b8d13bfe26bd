"""Whether the tests notice faults in the science: one fault at a time, and the tests aimed at it.

    python scripts/mutate.py -o MUTANTS.md [--only NAME,NAME] [--seconds 480]

`faults.yaml` lists faults of one line each: losses, masks, alignment, scaling, signs, sizes, rates,
constants of scores. Each is put into a copy of the checkout by itself, and the tests that should
notice are run there. The table says which fault was caught, and by which test. A run that is
stopped, or that `--seconds` ends, goes on when it is repeated with the same file; the faults that
are not in the list any more are forgotten. The tests are first run on the copy as it is.
"""

import argparse
import importlib
import os
import re
import shutil
import signal
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import pytest
import yaml

from data_prep.errors import BadInput, call_script

ROOT = Path(__file__).resolve().parent.parent
LIST = Path(__file__).with_name("faults.yaml")
COPIED = ("angie", "data_prep", "mraa", "scripts", "tests", "pyproject.toml", "README.md")
SLOW = ("torch", "torchvision", "lightning_fabric", "scipy.signal", "sklearn.cross_decomposition")
"""Libraries that are imported once."""

LIMIT = 300
"""Seconds after which tests that do not end have noticed."""


@dataclass(frozen=True)
class Fault:
    """One line of the science put wrong.

    Attributes:
        name: short, unique.
        file: in which.
        old: text that stands there exactly once.
        new: what is put in its place.
        tests: files of tests, or tests, that should notice.
    """

    name: str
    file: str
    old: str
    new: str
    tests: list[str]


def faults() -> list[Fault]:
    """The list."""
    return [Fault(**entry) for entry in yaml.safe_load(LIST.read_text())]


def run_tests(folder: Path, tests: list[str]) -> tuple[bool, str]:
    """Whether tests pass in a copy, and the first that does not.

    They run in a fork of this process, which has imported the slow libraries already.
    """
    child, output = os.fork(), folder / "output.txt"
    if child == 0:
        _test_here(folder, tests, output)
    ends = time.monotonic() + LIMIT
    while True:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            break
        if time.monotonic() > ends:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return False, f"no end in {LIMIT} s"
        time.sleep(0.05)
    text = output.read_text()
    found = re.search(r"^(?:FAILED|ERROR) (\S+)", text, re.MULTILINE)
    return status == 0, found[1] if found else " ".join(text.split())[-120:]


def _test_here(folder: Path, tests: list[str], output: Path) -> NoReturn:
    """Be the process that runs tests of a copy."""
    status = 1
    try:
        with output.open("w") as file:
            for stream in (1, 2):
                os.dup2(file.fileno(), stream)
        for name in [m for m in sys.modules if m.split(".")[0] in COPIED]:
            del sys.modules[name]  # those of the checkout
        sys.path = [str(folder), *(p for p in sys.path if Path(p).resolve() != ROOT)]
        os.chdir(folder)
        status = int(pytest.main(["-x", "-q", "-p", "no:cacheprovider", *tests]))
        sys.stdout.flush()
    finally:
        os._exit(status)


def tried(folder: Path, fault: Fault) -> str:
    """The test that notices a fault, or ""."""
    path = folder / fault.file
    text = path.read_text()
    if text.count(fault.old) != 1:
        raise BadInput(
            f"{fault.name}: {fault.old!r} stands {text.count(fault.old)} times in {path}"
        )
    path.write_text(text.replace(fault.old, fault.new))
    try:
        passed, first = run_tests(folder, fault.tests)
    finally:
        path.write_text(text)
    return "" if passed else first


def read(table: Path) -> dict[str, str]:
    """What a table says of faults, by their names."""
    if not table.is_file():
        return {}
    rows = [line.strip("|\n ").split(" | ") for line in table.read_text().splitlines()]
    return {row[0]: row[-1].strip("`") for row in rows if len(row) == 4 and row[0] != "fault"}


def write(table: Path, known: dict[str, str], listed: list[Fault]) -> None:
    """The table of what is known, in the order of the list."""
    there = [fault for fault in listed if fault.name in known]
    caught = sum(known[fault.name] != "not noticed" for fault in there)
    lines = [
        f"{caught} of {len(there)} faults noticed ({100 * caught / max(len(there), 1):.0f} %).",
        "",
        "| fault | where | in place of | noticed by |",
        "|---|---|---|---|",
    ]
    for fault in there:
        said = known[fault.name]
        noticed = said if said == "not noticed" else f"`{said}`"
        old, new = (" ".join(text.split()).replace("|", "\\|") for text in (fault.old, fault.new))
        lines.append(f"| {fault.name} | {fault.file}: `{new or 'nothing'}` | `{old}` | {noticed} |")
    table.write_text("\n".join(lines) + "\n")


def main() -> None:
    """Try all faults that are not in the table yet."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--only", default="", help="names of faults, with commas; tried anew")
    parser.add_argument("--seconds", type=float, default=0.0, help="stop after these; 0 for never")
    given = parser.parse_args()
    listed, known, began = faults(), read(given.output), time.monotonic()
    only = [name for name in given.only.split(",") if name]
    unknown = set(only) - {fault.name for fault in listed}
    if unknown:
        raise BadInput(f"--only {','.join(sorted(unknown))}: no such fault in {LIST.name}")
    due = [f for f in listed if (f.name in only if only else f.name not in known)]
    for name in SLOW:
        importlib.import_module(name)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for name in COPIED:
            source, target = ROOT / name, folder / name
            if source.is_dir():
                shutil.copytree(source, target, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                shutil.copy(source, target)
        sound: set[str] = set()
        for fault in due:
            if given.seconds and time.monotonic() - began > given.seconds:
                print(f"{len(listed) - len(known)} faults are left; run it again")
                break
            fresh = [test for test in fault.tests if test not in sound]
            passed, first = run_tests(folder, fresh) if fresh else (True, "")
            if not passed:
                print(f"{fault.name}: not tried, {first} fails without any fault", flush=True)
                continue
            sound |= set(fresh)
            known[fault.name] = tried(folder, fault) or "not noticed"
            print(f"{fault.name}: {known[fault.name]}", flush=True)
            write(given.output, known, listed)


if __name__ == "__main__":
    call_script(main)
