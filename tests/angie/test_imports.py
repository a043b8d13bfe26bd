"""What a command imports before it starts: seconds that everybody waits."""

import subprocess
import sys

import pytest

LIBRARIES = "torch numba scipy cv2 av lightning_fabric tensorboard librosa matplotlib".split()
"""What the command line itself has no use for, so that its help and its messages come at once."""

TRAINING = "lightning_fabric tensorboard librosa matplotlib pandas sklearn torchvision".split()
"""What no video needs; nor parts of scipy that take long to import."""


@pytest.mark.parametrize(
    ("module", "unwanted"),
    [
        ("angie.cli", LIBRARIES),
        ("angie.source", ["torch", "numba", "scipy"]),
        ("angie.pipeline", [*TRAINING, "scipy.signal", "scipy.stats", "scipy.spatial"]),
    ],
)
def test_imports_are_few(module, unwanted):
    code = f"import sys, {module}; print([m for m in {unwanted} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
