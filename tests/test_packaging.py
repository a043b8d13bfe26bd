"""What pyproject.toml declares is what the packages import, no more and no less."""

import ast
import importlib.metadata
import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parent.parent
PACKAGES = ("angie", "mraa", "data_prep")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def names(requirements):
    return {re.match(r"[\w.-]+", text)[0].lower().replace("_", "-") for text in requirements}


def imported():
    """Modules of others that the packages import, at the top of a file or inside a function."""
    found = set()
    for path in (path for name in PACKAGES for path in (ROOT / name).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                found.add(node.module.split(".")[0])
            elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
                found |= {a.value.split(".")[0] for a in node.args if isinstance(a, ast.Constant)}
    return found - set(sys.stdlib_module_names) - set(PACKAGES)


def test_dependencies_are_what_is_imported():
    known = importlib.metadata.packages_distributions()
    providers = {module: {name.lower().replace("_", "-") for name in known.get(module, [])}
                 for module in imported()}  # fmt: skip
    declared = names(PROJECT["dependencies"])
    extras = names(text for group in PROJECT["optional-dependencies"].values() for text in group)
    undeclared = {m for m, dists in providers.items() if not dists & (declared | extras)}
    assert undeclared == set()
    assert declared - set().union(*providers.values()) == set()


def test_every_package_is_typed():
    assert all((ROOT / name / "py.typed").is_file() for name in PACKAGES)
