"""Gesture generators: speech in, region motion out. The registry of their families.

A family is imported when it is asked for, so that opening one imports no other. Packages add
their own by an entry point of the group "angie.generators" that names a `Family`::

    [project.entry-points."angie.generators"]
    mine = "my_package.generator:FAMILY"
"""

from collections.abc import Callable
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Any

from data_prep.errors import BadInput

if TYPE_CHECKING:
    from angie.generators.base import Family

GROUP = "angie.generators"

DEFAULT = "angie"
"""The family that is meant where none is named."""

DEFAULT_FEATURES = ("onset", "mfcc")
"""What it reads of speech, known before its libraries are imported."""


def _angie() -> "Family":
    from angie.generators.angie.family import FAMILY

    return FAMILY


def _tricon() -> "Family":
    from angie.generators.tricon.family import FAMILY

    return FAMILY


def upgraded(manifest: dict[str, Any]) -> dict[str, Any]:
    """The manifest of format 2 of a bundle of format 1, which knew ANGIE alone.

    Raises:
        ValueError: settings that are no longer there.
    """
    from angie.generators.angie.format1 import upgrade

    return upgrade(manifest)


GENERATORS: dict[str, Callable[[], "Family"]] = {"angie": _angie, "tricon": _tricon}
"""What makes a family, by its name; programs may put their own here."""


def names() -> list[str]:
    """Names of all families: those of this package, then those of others."""
    others = sorted({entry.name for entry in entry_points(group=GROUP)} - GENERATORS.keys())
    return [*GENERATORS, *others]


def family(name: str | None = None) -> "Family":
    """The family of a name; None is `DEFAULT`.

    Raises:
        BadInput: there is none of this name, or the package that names it cannot be imported.
    """
    name = name or DEFAULT
    if name in GENERATORS:
        return GENERATORS[name]()
    for entry in entry_points(group=GROUP, name=name):
        try:
            found: Family = entry.load()
        except (ImportError, AttributeError) as error:
            raise BadInput(
                f"--generator {name}: {entry.value} cannot be loaded ({error})"
            ) from error
        return found
    raise BadInput(
        f"--generator {name}: there is no such generator; choose from {', '.join(names())}"
    )
