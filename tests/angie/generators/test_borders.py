"""Whatever stands outside a generator's own folder knows it by its family alone."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[3]
OWN = ("angie/generators/angie/", "angie/generators/__init__.py")
"""ANGIE's folder and the registry; scripts that measure ANGIE itself end in `_angie.py`."""

NETWORKS = re.compile(
    r"generators\.angie\b|angie\.(vq|gpt|refiner)\b|\b(vq|gpt|refiner)\.\w|\"(vq|gpt|refiner)\""
    r"|VQMotionExtractor|CoSpeechGPT|DirectMotion|\bRefiner\b|VQ motion extractor|no_quant"
)


def named(root: Path) -> list[str]:
    """Places under a folder where ANGIE's networks are named from outside."""
    found = []
    for path in sorted(p for d in ("angie", "mraa", "data_prep", "scripts")
                       for p in (root / d).rglob("*.py")):  # fmt: skip
        place = path.relative_to(root).as_posix()
        if place.startswith(OWN) or place.endswith("_angie.py"):
            continue
        lines = enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        found += [f"{place}:{i}: {line}" for i, line in lines if NETWORKS.search(line)]
    return found


def test_nothing_outside_its_folder_and_the_registry_names_angies_networks():
    assert named(ROOT) == []


def test_a_name_is_found(tmp_path):
    (tmp_path / "angie").mkdir()
    (tmp_path / "angie" / "new.py").write_text("from angie.generators.angie.gpt import CoSpeechGPT")
    assert len(named(tmp_path)) == 1
