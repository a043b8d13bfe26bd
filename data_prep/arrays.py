"""NumPy files (.npy, .npz) of anybody's making, read without trusting what they say."""

import os
from collections.abc import Collection
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


def read_arrays(path: Path, names: Collection[str] | None = None) -> dict[str, NDArray]:
    """Arrays of an .npz file by name; the array of an .npy file under the name "".

    Nothing pickled is loaded. A file that claims more than it has costs no memory.

    Args:
        path: the file.
        names: those that are wanted, as far as they are there; None for all.

    Raises:
        ValueError: what is wrong with it, on one line, whatever that is.
    """
    if not Path(path).is_file():
        raise ValueError("no such file" if not os.path.lexists(path) else "is no file")
    try:
        loaded = np.load(path, allow_pickle=False)
        if isinstance(loaded, np.ndarray):
            return {"": loaded}
        with loaded as file:
            found = [name for name in file.files if names is None or name in names]
            return {name: np.asarray(file[name]) for name in found}
    except OSError as error:
        raise ValueError(error.strerror or "cannot be read") from error
    except Exception as error:  # damaged headers and archives make NumPy raise many kinds
        text = " ".join(str(error).split())
        known = "no array file" if "pickle" in text else text[:100]
        raise ValueError(known or type(error).__name__) from error
