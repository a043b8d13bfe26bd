"""Safetensors files, written as any other file is: errors are the system's, so is the mode."""

import json
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open


def save_tensors(
    path: Path, tensors: Mapping[str, Any], notes: Mapping[str, str] | None = None
) -> None:
    """Write a safetensors file.

    Args:
        path: the file to write.
        tensors: NumPy arrays, or contiguous tensors on the CPU, by name.
        notes: texts for its metadata.

    Raises:
        OSError: the disk is full, or whatever else the system says; nothing is left then.
    """
    path = Path(path)
    path.touch()
    mode = path.stat().st_mode  # as the user's mask has it; safetensors makes private files
    if all(isinstance(values, np.ndarray) for values in tensors.values()):
        from safetensors.numpy import save_file
    else:
        from safetensors.torch import save_file  # type: ignore[assignment]
    try:
        save_file(dict(tensors), str(path), None if notes is None else dict(notes))
    except SafetensorError as error:
        path.unlink(missing_ok=True)
        number = re.search(r"os error (\d+)", str(error))
        if number is None:
            raise
        code = int(number[1])
        raise OSError(code, os.strerror(code), str(path)) from error
    if notes is not None and len(notes) > 1:
        _sort_notes(path)
    path.chmod(mode)


def _sort_notes(path: Path) -> None:
    """Put the notes of a file in order: the library's order is another in every process."""
    with path.open("r+b") as file:
        size = int.from_bytes(file.read(8), "little")
        header = json.loads(file.read(size))
        header["__metadata__"] = dict(sorted(header["__metadata__"].items()))
        text = json.dumps(header, ensure_ascii=False, separators=(",", ":")).encode()
        if len(text) <= size:
            file.seek(8)
            file.write(text.ljust(size))


def open_tensors(path: Path, framework: str = "pt") -> Any:
    """A safetensors file, open for reading as `safetensors.safe_open` gives it.

    Raises:
        SafetensorError: no such file, a pipe or a device (which would be waited for), or damaged.
    """
    if not Path(path).is_file():
        raise SafetensorError("is no file" if os.path.lexists(path) else "no such file")
    try:
        return safe_open(str(path), framework=framework)
    except OSError as error:
        raise SafetensorError(error.strerror or str(error)) from error


def load_tensors(path: Path) -> dict[str, Any]:
    """All tensors of a safetensors file, on the CPU.

    Raises:
        SafetensorError: as `open_tensors`.
    """
    with open_tensors(path) as file:
        return {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a dict)
