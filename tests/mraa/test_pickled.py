"""Files that torch.save wrote: what each that cannot be read is called."""

import os
import pickle

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from data_prep.errors import BadInput
from mraa.pickled import load_pickled
from mraa.released import read_checkpoint

STATE = {"generator": {"a": torch.zeros(300)}, "region_predictor": {"b": torch.ones(300)}}


class Hostile:
    def __reduce__(self):
        return (os.mkdir, ("hostile-was-here",))


@pytest.mark.parametrize("zipped", [True, False])
def test_the_cause_is_named(tmp_path, monkeypatch, zipped):
    monkeypatch.chdir(tmp_path)
    options = {"_use_new_zipfile_serialization": zipped}
    path = tmp_path / "a.pth"
    torch.save(STATE, path, **options)
    assert load_pickled(path)["region_predictor"]["b"].sum() == 300
    whole = path.read_bytes()

    def said(content: object) -> str:
        if isinstance(content, bytes):
            path.write_bytes(content)
        else:
            torch.save(content, path, **options)
        with pytest.raises(BadInput) as caught:
            load_pickled(path)
        assert "\n" not in str(caught.value) and str(caught.value).startswith(str(path))
        return str(caught.value)

    for cut in (30, 300, len(whole) // 2, len(whole) - 1):
        assert "is cut short" in said(whole[:cut])
    assert "numpy" in said({**STATE, "epoch": np.float64(3)})
    assert "objects other than tensors" in said(torch.nn.Linear(2, 2))
    assert "mkdir" in said(Hostile())
    assert "no file that torch.save wrote" in said(pickle.dumps(Hostile()))
    assert not (tmp_path / "hostile-was-here").exists()
    assert "web page" in said(b"<!DOCTYPE html><html></html>")
    assert "Git LFS pointer" in said(b"version https://git-lfs.github.com/spec/v1\noid")
    assert "no file that torch.save wrote" in said(b"\x17" * 900)
    save_file({"a": torch.zeros(3)}, path)
    assert "safetensors" in said(path.read_bytes())


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float64])
def test_tensors_of_any_float_type_are_read(tmp_path, dtype):
    state = {part: {k: v.to(dtype) for k, v in one.items()} for part, one in STATE.items()}
    torch.save(state, tmp_path / "a.pth")
    read = read_checkpoint(tmp_path / "a.pth")
    assert read["region_predictor"]["b"].dtype == torch.float32
    assert read["region_predictor"]["b"].sum() == 300
