"""Files that torch.save wrote, read without running what they hold; why one cannot be read."""

import pickletools
import re
import warnings
import zipfile
from pathlib import Path
from typing import Any

import torch

from data_prep.errors import BadInput
from data_prep.media.container import check_file
from data_prep.media.kinds import kind_of

_MAGIC = b"\x80\x02\x8a\nl\xfc\x9cF\xf9 j\xa8P\x19."
"""With which files begin that PyTorch wrote before version 1.6."""


def load_pickled(path: Path) -> Any:
    """Content of a `.pth`, by weights-only loading: tensors, texts, numbers and their tables.

    Raises:
        BadInput: missing, or not such a file: what it is instead.
    """
    path = Path(path)
    check_file(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # torch tells of old formats
            return torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises many kinds for a damaged or hostile file
        raise BadInput(f"{path}: not a readable checkpoint: {_cause(path, error)}") from error


def _cause(path: Path, error: Exception) -> str:
    """What a file is that cannot be loaded, and what to do."""
    kind = kind_of(path)
    if kind and not kind.startswith("a ZIP archive"):
        return f"it is {kind}"
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(len(_MAGIC))
    if head[:4] == b"PK\x03\x04":
        names = _names(path)
        if names is None:
            return f"it is cut short (after {size} bytes); download or copy it again"
        if not any(name.endswith("data.pkl") for name in names):
            return "it is a ZIP archive of other things; name the .pth in it"
    elif int.from_bytes(head[:8], "little") < size and head[8:9] == b"{":
        return "it is a safetensors file under another name; name it .safetensors"
    elif head != _MAGIC[:size]:
        return "it is no file that torch.save wrote; download it again"
    if found := re.search(r"GLOBAL (?:\w+ )?`?([a-z_]\w*(?:\.\w+)+)", str(error)):
        what = f"it holds objects other than tensors ({found[1]})"
        return f"{what}, which are not loaded from a stranger's file; save its state dicts alone"
    if isinstance(error, EOFError) or "unexpected EOF" in str(error) or _is_cut(path):
        return f"it is cut short (after {size} bytes); download or copy it again"
    return f"it is damaged ({type(error).__name__}); download or copy it again"


def _names(path: Path) -> list[str] | None:
    """Names in a ZIP archive; None where its end, which lists them, is missing or damaged."""
    try:
        with zipfile.ZipFile(path) as archive:
            return archive.namelist()
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError):
        return None


def _is_cut(path: Path) -> bool:
    """Whether a pickle of the old format ends before it is over."""
    with path.open("rb") as file:
        try:
            for _ in range(4):  # a number, a version, the system's sizes, and the content
                for _ in pickletools.genops(file):
                    pass
        except Exception as error:  # of whatever kind: it is told as damage
            words = ("exhausted", "not enough data", "remain", "no newline")
            return any(word in str(error) for word in words)
    return False
