"""Speech and a photo to a gesture video: motion, generators, bundles and the `angie` command."""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from angie.motion.saved import load_motion as load_motion
    from angie.pipeline import GesturePipeline as GesturePipeline
    from angie.video import GestureVideo as GestureVideo
    from data_prep.errors import Cancelled as Cancelled

__version__ = "0.1.0"


_WHERE = {
    "GesturePipeline": "angie.pipeline",
    "GestureVideo": "angie.video",
    "load_motion": "angie.motion.saved",
    "Cancelled": "data_prep.errors",
}


def __getattr__(name: str) -> Any:
    """Import the pipeline when it is asked for: torch takes seconds."""
    if name in _WHERE:
        return getattr(importlib.import_module(_WHERE[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
