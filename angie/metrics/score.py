"""A score and what it was computed from, or why it could not be computed."""

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from functools import wraps
from typing import Any, ParamSpec

import numpy as np

P = ParamSpec("P")


@dataclass(frozen=True)
class Score:
    """One number of a report.

    Attributes:
        value: the score, finite; None when it cannot be computed.
        reason: why there is no value; empty when there is one.
        counts: what it was computed from, such as clips, windows and beats.
        warning: why the value is to be read with care; empty when it is sound.
        deviation: standard deviation over clips, where the score's source states one.
    """

    value: float | None
    reason: str = ""
    counts: Mapping[str, int] = field(default_factory=dict)
    warning: str = ""
    deviation: float | None = None

    def __post_init__(self) -> None:
        if (self.value is None) == (not self.reason):
            raise ValueError("a score has either a value or a reason why it has none")
        if self.value is not None and not math.isfinite(self.value):
            raise ValueError(f"a score is a finite number, not {self.value}")

    @classmethod
    def missing(cls, reason: str, **counts: int) -> "Score":
        """A score that cannot be computed."""
        return cls(None, reason, counts)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for a report."""
        return asdict(self)


def finite(motions: int = 1) -> Callable[[Callable[P, Score]], Callable[P, Score]]:
    """A metric of which the first arguments, so many, are motion: clips, or an array of windows.

    Where their numbers are not finite there is no score.
    """

    def wrap(metric: Callable[P, Score]) -> Callable[P, Score]:
        @wraps(metric)
        def checked(*args: P.args, **options: P.kwargs) -> Score:
            given: Any = args[:motions]
            clips = [c for one in given for c in ([one] if isinstance(one, np.ndarray) else one)]
            broken = sum(not np.isfinite(clip).all() for clip in clips)
            if broken:
                return Score.missing("motion is not finite", **{"not finite": broken})
            return metric(*args, **options)

        return checked

    return wrap
