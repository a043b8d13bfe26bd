"""Compiled loops work where nothing can be kept on disk, and are kept where it can."""

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


os.makedirs = guarded(os.makedirs)
tempfile.TemporaryFile = guarded(tempfile.TemporaryFile)  # by which numba tries a folder

from mraa import warp_kernel

out = np.empty((1, 2, 2, 3), np.float32)
warp_kernel.join(np.ones((1, 2, 2, 8), np.float32), np.zeros((1, 2, 2, 1), np.float32), out)
print(int(out.sum()))
"""


@pytest.mark.slow
@pytest.mark.parametrize("home", ["writable", "read-only"])
def test_where_the_package_cannot_be_written(tmp_path, home):
    package, user = tmp_path / "package", tmp_path / "user"
    source = Path(__file__).resolve().parents[3] / "mraa"
    shutil.copytree(source, package / "mraa", ignore=shutil.ignore_patterns("__pycache__"))
    forbidden = [str(package)] if home == "writable" else [str(package), str(user)]
    places = {"HOME": str(user), "XDG_CACHE_HOME": str(user / "cache"), "PYTHONPATH": str(package)}
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"} | places
    result = subprocess.run(
        [sys.executable, "-B", "-c", CODE, *forbidden],
        cwd=package,
        env=environment,
        capture_output=True,
        text=True,
    )
    assert result.returncode == 0, result.stderr
    assert result.stdout.strip() == "8"
    assert not list(package.rglob("*.nbi"))
    assert bool(list(user.rglob("*.nbi"))) == (home == "writable")
