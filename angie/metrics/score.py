"""A score and what it was computed from, or why it could not be computed."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray


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
        return {
            "value": self.value,
            "reason": self.reason,
            "counts": dict(self.counts),
            "warning": self.warning,
            "deviation": self.deviation,
        }


def not_finite(*motions: Sequence[NDArray]) -> Score | None:
    """Why clips, or windows, cannot be scored when numbers of theirs are not finite, else None."""
    broken = sum(not np.isfinite(clip).all() for clips in motions for clip in clips)
    return Score.missing("motion is not finite", **{"not finite": broken}) if broken else None
