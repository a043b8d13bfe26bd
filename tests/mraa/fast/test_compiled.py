"""Compiled loops are kept in a folder of the user's own, and work where there is none."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

CODE = """
import os, sys, tempfile
import numpy as np

forbidden = tuple(sys.argv[1:])


def guarded(function):
    def call(*args, **options):
        place = str(options.get("dir", args[0] if args else ""))
        if place.startswith(forbidden):
            raise PermissionError(place)
        return function(*args, **options)

    return call


os.makedirs, os.mkdir = guarded(os.makedirs), guarded(os.mkdir)
tempfile.TemporaryFile = guarded(tempfile.TemporaryFile)  # by which numba tries a folder

from mraa.fast import warp_kernel

out = np.empty((1, 2, 2, 3), np.float32)
warp_kernel.join(np.ones((1, 2, 2, 8), np.float32), np.zeros((1, 2, 2, 1), np.float32), out)
print(int(out.sum()), sum(warp_kernel.join.stats.cache_hits.values()))
"""


def run(package, user, *forbidden, **more):
    """The sum of what a kernel wrote, and how often it was read from the cache."""
    places = {"HOME": str(user), "PYTHONPATH": str(package)}
    caches = ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")
    environment = {k: v for k, v in os.environ.items() if k not in caches}
    result = subprocess.run(
        [sys.executable, "-B", "-c", CODE, *map(str, forbidden)],
        cwd=package,
        env=environment | places | more,
        capture_output=True,
        text=True,
    )
    assert result.returncode == 0, result.stderr
    assert not list(package.rglob("*.nbi"))
    return result.stdout.split()


@pytest.fixture
def package(tmp_path):
    source = Path(__file__).resolve().parents[3]
    for name in ("mraa", "data_prep"):
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(source / name, tmp_path / "package" / name, ignore=ignored)
    return tmp_path / "package"


def test_the_second_run_reads_what_the_first_compiled(package, tmp_path):
    user = tmp_path / "user"
    assert run(package, user) == ["8", "0"]
    assert run(package, user, package) == ["8", "1"]
    assert list((user / ".cache" / "angie" / "numba").rglob("*.nbi"))


@pytest.mark.slow  # compiles twice more
def test_where_the_cache_cannot_be_written(package, tmp_path):
    """As where another user made it; a temporary folder serves, and is gone afterwards."""
    user, temporary = tmp_path / "user", tmp_path / "temporary"
    (user / ".cache" / "angie" / "numba").mkdir(parents=True)
    temporary.mkdir()
    assert run(package, user, package, user, TMPDIR=str(temporary)) == ["8", "0"]
    assert not list(user.rglob("*.nbi")) and not list(temporary.iterdir())
    assert run(package, user, package, user, temporary, TMPDIR=str(temporary)) == ["8", "0"]
