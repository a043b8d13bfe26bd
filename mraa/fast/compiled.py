"""Loops compiled by numba, kept on disk where that is possible."""

from collections.abc import Callable
from typing import Any

from data_prep.files import numba_cache
from mraa.fast import enabled


def compiled(function: Callable[..., Any]) -> Any:
    """Compile a function for numbers and arrays at its first call; it holds no lock while it runs.

    What was compiled is kept in the user's cache, so that only the first run compiles; where there
    is none, every run does. Numba compiles anew when that module's file changes: compiled functions
    that it calls belong into the same.
    """
    if not enabled():
        return function
    numba_cache()
    from numba import njit

    settings: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
    settings["fastmath"] = {"contract"}  # a product is added in one step
    try:
        return njit(cache=True, **settings)(function)
    except RuntimeError:  # numba found no folder that it can write to
        return njit(**settings)(function)
