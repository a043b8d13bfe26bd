"""A fast sample of scripts/check_numbers.py."""

from pathlib import Path

import pytest
import torch

SCRIPTS = Path(__file__).resolve().parents[1] / "scripts"


def test_the_worst_of_motions_stay_finite(monkeypatch):
    monkeypatch.syspath_prepend(str(SCRIPTS))
    import check_numbers

    regions = check_numbers.check_motions(20_000, 200, seed=3)
    assert regions.shift.shape == (200, 2)
    check_numbers.check_flow(regions, seed=3)
    with pytest.raises(check_numbers.Fault, match="1 of 2"):
        check_numbers.check(torch.tensor([1.0, torch.nan]).isfinite(), "finite")
