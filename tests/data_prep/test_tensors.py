"""Safetensors files: the usual mode, and the system's errors."""

import errno
import os
import subprocess
import sys

import numpy as np
import pytest
import torch
from safetensors import SafetensorError, safe_open
from safetensors.numpy import load_file

from data_prep import tensors
from data_prep.tensors import save_tensors


@pytest.mark.parametrize("mask, mode", [(0o022, 0o644), (0o002, 0o664), (0o077, 0o600)])
@pytest.mark.parametrize("values", [np.arange(3.0), torch.arange(3.0)])
def test_the_file_has_the_mode_of_any_other(tmp_path, mask, mode, values):
    before = os.umask(mask)
    try:
        save_tensors(tmp_path / "a.safetensors", {"a": values}, {"about": "x"})
    finally:
        os.umask(before)
    assert (tmp_path / "a.safetensors").stat().st_mode & 0o777 == mode
    np.testing.assert_array_equal(load_file(tmp_path / "a.safetensors")["a"], [0, 1, 2])


def test_the_same_content_gives_the_same_bytes_in_every_process(tmp_path):
    code = (
        "import numpy as np, sys; from pathlib import Path\n"
        "from data_prep.tensors import save_tensors\n"
        "notes = {name: 'é\\n' + name for name in 'bdaceifgh'}\n"
        "save_tensors(Path(sys.argv[1]), {'a': np.arange(3.0), 'b': np.zeros(2)}, notes)"
    )
    files = [tmp_path / f"{number}.safetensors" for number in range(3)]
    root = os.path.dirname(os.path.dirname(tensors.__file__))
    for file in files:
        subprocess.run([sys.executable, "-c", code, file], check=True, cwd=root)
    assert len({file.read_bytes() for file in files}) == 1
    with safe_open(files[0], "np") as file:
        assert file.metadata() == {name: "é\n" + name for name in "abcdefghi"}
        np.testing.assert_array_equal(file.get_tensor("a"), [0, 1, 2])


def test_what_the_system_says_of_a_full_disk_comes_through(tmp_path, monkeypatch):
    def full(*_):
        raise SafetensorError("Error while serializing: I/O error: No space left (os error 28)")

    monkeypatch.setattr("safetensors.numpy.save_file", full)
    with pytest.raises(OSError) as caught:
        save_tensors(tmp_path / "a.safetensors", {"a": np.zeros(3)})
    assert caught.value.errno == errno.ENOSPC
    assert caught.value.filename == str(tmp_path / "a.safetensors")
    assert not list(tmp_path.iterdir())


def test_no_other_module_writes_such_files():
    """So that none forgets the mode and the errors."""
    root = os.path.dirname(os.path.dirname(tensors.__file__))
    for package in ("angie", "mraa", "data_prep"):
        for folder, _, names in os.walk(os.path.join(root, package)):
            for name in names:
                if name.endswith(".py") and name != "tensors.py":
                    with open(os.path.join(folder, name), encoding="utf-8") as file:
                        assert "save_file" not in file.read(), name
