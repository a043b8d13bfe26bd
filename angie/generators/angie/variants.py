"""The variants of the paper's Table 3, a setting each."""

from dataclasses import replace

from angie.generators.angie.settings import AngieSettings
from angie.generators.base import Variant


def _quantised(settings: AngieSettings, quant: str) -> AngieSettings:
    generation = replace(settings.generation, refine=True)
    return replace(settings, vq=replace(settings.vq, quant=quant), generation=generation)


def _without_refiner(settings: AngieSettings) -> AngieSettings:
    whole = _quantised(settings, "full")
    return replace(whole, generation=replace(whole.generation, refine=False))


VARIANTS = {
    "no_quant": Variant(lambda settings: _quantised(settings, "no_quant")),
    "mu_L": Variant(lambda settings: _quantised(settings, "mu_L")),
    "dmu_L": Variant(lambda settings: _quantised(settings, "dmu_L")),
    "mu_dL": Variant(lambda settings: _quantised(settings, "mu_dL")),
    "no_cholesky": Variant(lambda settings: _quantised(settings, "no_cholesky")),
    "no_refine": Variant(_without_refiner, parts_of="full"),
    "full": Variant(lambda settings: _quantised(settings, "full")),
}
"""Rows of the table in the paper's order; `no_cholesky` is of its section 3.2."""
