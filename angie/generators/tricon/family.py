"""TriCon as a family of generators: settings, presets, variants; how a bundle's is loaded."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from torch import Tensor

from angie.generators.base import Family, GestureGenerator, Variant
from angie.generators.stages import Parts, Stage
from angie.generators.tricon.generate import PART, TriConGenerator, load_model
from angie.generators.tricon.model import TriCon, TriConConfig
from angie.generators.tricon.train import PAPER, TriConTraining, train_generator
from angie.motion.statistics import MotionStatistics


@dataclass(frozen=True)
class TriConSettings:
    """Sizes and training; the defaults are the paper's.

    Attributes:
        model: sizes of the networks.
        train: how they are trained.
    """

    model: TriConConfig = field(default_factory=TriConConfig)
    train: TriConTraining = field(default_factory=TriConTraining)


def lite() -> TriConSettings:
    """What ships: 2 million weights, trained in half an hour on a laptop CPU."""
    return TriConSettings(
        TriConConfig(width=160, layers=2, buckets=8192, word_width=64),
        TriConTraining(
            schedule=replace(PAPER, rate=1e-3, batch=32, milestones=(80,), most_steps=2500),
            least_words=0,
            drop_plain=0.0,
            drop_still=0.0,
            word_dropout=0.2,
            checks=20,
            judge_steps=1000,
        ),
    )


def tiny() -> TriConSettings:
    """For tests and first tries: trains in seconds."""
    return TriConSettings(
        TriConConfig(points=10, width=16, layers=1, buckets=256, word_width=8, dropout=0.1),
        TriConTraining(
            schedule=replace(PAPER, rate=2e-3, batch=16, most_steps=40),
            least_words=0,
            drop_plain=0.0,
            drop_still=0.0,
            word_dropout=0.2,
            checks=2,
            judge_steps=20,
        ),
    )


def fit(settings: TriConSettings, points: int, without_extent: bool) -> TriConSettings:
    """The settings for so many regions, or points without extent."""
    bones = settings.model.bones if len(settings.model.bones) == points else ()
    model = replace(settings.model, points=points, extent=not without_extent, bones=bones)
    return replace(settings, model=model)


def _model(**changes: Any) -> Variant:
    """Another model."""
    return Variant(lambda s: replace(s, model=replace(s.model, **changes)), several=True)


def _train(**changes: Any) -> Variant:
    """The whole model, trained in another way."""
    return Variant(lambda s: replace(s, train=replace(s.train, **changes)), several=True)


def _sizes(settings: TriConSettings) -> Mapping[str, Any]:
    return {"model": settings.model}


def _build(settings: TriConSettings) -> TriCon:
    hashed = replace(settings.model, encoder="hash")  # a file is read when it is needed
    return TriCon(hashed)


def _resumes(settings: TriConSettings) -> Mapping[str, Any]:
    kept = ("stride", "least_words", "drop_plain", "drop_still", "vectors")
    return {name: getattr(settings.train, name) for name in kept}


def _styles(settings: TriConSettings, statistics: MotionStatistics) -> tuple[str, ...]:
    return statistics.speakers if settings.model.identity else ()


def _draws(generator: GestureGenerator, count: int) -> dict[str, Tensor]:
    assert isinstance(generator, TriConGenerator)
    if not generator.model.config.identity:
        return {}
    return {
        name: torch.stack([generator.style_of(name, seed, False) for seed in range(count)])
        for name in generator.statistics.speakers
    }


def load(parts: Parts, precision: str = "fp32") -> TriConGenerator:
    """The generator of a bundle; it computes in float32 whatever the precision."""
    return TriConGenerator(load_model(parts), parts.statistics())


def in_words(stage: str, report: dict[str, Any], settings: TriConSettings) -> list[str]:
    """What is said of the part in `angie info`."""
    words = [f"{report['weights'] / 1e6:.2f} million weights"] if "weights" in report else []
    if "fgd" in report:
        words.append(
            f"held-out FGD {report['fgd']:.2f} (first pose held {report['fgd_still']:.2f})"
        )
    return words


FAMILY = Family(
    name=PART.partition(".")[0],
    title="TriCon",
    settings=TriConSettings,
    presets={"lite": lite, "tiny": tiny},
    stages=(
        Stage("generator", ("statistics",), train_generator, _sizes, _build, resumes=_resumes),
    ),
    load=load,
    fit=fit,
    styles=_styles,
    style_space=lambda settings: settings.model.style if settings.model.identity else 0,
    style_draws=_draws,
    style_advice="tricon.model.identity=true",
    variants={
        "no_words": _model(context="sound"),
        "no_sound": _model(context="words"),
        "no_identity": _model(identity=False),
        "no_adversarial": _train(adversarial=0.0),
        "no_regularisers": _train(style=0.0, divergence=0.0),
        "full": _model(context="both", identity=True),
    },
    report=in_words,
)
"""Variants are the rows of the paper's table of ablations."""
