"""Speech and a photo to a gesture video: motion, generators, bundles and the `angie` command."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from angie.pipeline import GesturePipeline as GesturePipeline
    from angie.pipeline import GestureVideo as GestureVideo

__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    """Import the pipeline when it is asked for: torch takes seconds."""
    if name in ("GesturePipeline", "GestureVideo"):
        from angie import pipeline

        return getattr(pipeline, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
