"""Style spaces in the report: where the training speakers lie, and how each style gestures.

As figure 9 of TriCon (TOG 2020), by principal components in place of UMAP.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from angie.evaluation.rows import System
from angie.evaluation.space import RegionSpace, points
from angie.metrics.frechet import principal
from data_prep.rates import FPS
from data_prep.speech.synchrony import steps

DRAWS = 40
"""Styles drawn of each speaker."""

SECONDS = 10
"""Of the first test clip that is gestured to in every style."""


def style_spaces(space: RegionSpace, entered: Sequence[System]) -> list[dict[str, Any]]:
    """The style spaces of generators that have one.

    Returns:
        of each: `row`, its name; `points`, the first two principal components of styles drawn of
        each speaker, and `share`, the part of their variance that these keep; `speed`, mean speed
        of what gestures in each style to the same sound, and `right`, the part of it on the
        picture's right side, both of the middle of the speaker's styles.
    """
    found = []
    for system in entered:
        draws_of, generator = system.family.style_draws, system.load()
        draws = {} if draws_of is None else draws_of(generator, DRAWS)
        if len(draws) < 2:
            continue
        together = np.concatenate([part.double().numpy() for part in draws.values()])
        centre = together.mean(0)
        flat = (together - centre) @ principal(together, 2)
        share = flat.var(0).sum() / max((together - centre).var(0).sum(), 1e-12)
        clip = space.test[0]
        frames = min(clip.motion.frames, SECONDS * FPS)
        right = points(clip.motion)[:, space.active, 0].mean(0) > 0
        speed, side = {}, {}
        for name in draws:
            made = generator.generate(clip.speech, clip.motion[:1], frames, style=name, greedy=True)
            moved = steps(points(made)[:, space.active])[1:].mean(0) * FPS * (space.pixel or 1)
            speed[name] = round(float(moved.mean()), 3)
            side[name] = round(float(moved[right].sum() / max(moved.sum(), 1e-12)), 3)
        parts = np.split(flat.round(4), len(draws))
        found.append({
            "row": system.name, "share": round(float(share), 3), "speed": speed, "right": side,
            "points": {name: part.tolist() for name, part in zip(draws, parts, strict=True)},
        })  # fmt: skip
    return found
