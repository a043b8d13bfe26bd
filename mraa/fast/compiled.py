"""Loops compiled by numba, kept on disk where that is possible."""

from collections.abc import Callable
from typing import Any

from numba import njit


def compiled(function: Callable[..., Any]) -> Any:
    """Compile a function for numbers and arrays at its first call; it holds no lock while it runs.

    What was compiled is kept beside the module, or in the user's cache where that cannot be
    written, so that only the first run compiles; where neither can, every run does. Numba compiles
    anew when that module's file changes: compiled functions that it calls belong into the same.
    """
    settings: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
    try:
        return njit(cache=True, **settings)(function)
    except RuntimeError:  # numba found no folder that it can write to
        return njit(**settings)(function)
