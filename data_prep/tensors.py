"""Safetensors files, written as any other file is: errors are the system's, so is the mode."""

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError


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
    path.chmod(mode)
