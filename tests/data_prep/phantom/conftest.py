import runpy
from pathlib import Path
from types import SimpleNamespace

import pytest


@pytest.fixture(scope="session")
def scoring() -> SimpleNamespace:
    """What `scripts/check_phantom.py` scores the phantom by."""
    script = Path(__file__).parents[3] / "scripts" / "check_phantom.py"
    return SimpleNamespace(**runpy.run_path(str(script)))
