"""What pyproject.toml declares is what the packages import, no more and no less."""

import ast
import importlib.metadata
import json
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
    providers = {  # of an extra that is not installed here, what is imported is its name
        module: {name.lower().replace("_", "-") for name in known.get(module, [module])}
        for module in imported()
    }
    declared = names(PROJECT["dependencies"])
    extras = names(text for group in PROJECT["optional-dependencies"].values() for text in group)
    undeclared = {m for m, dists in providers.items() if not dists & (declared | extras)}
    assert undeclared == set()
    assert declared - set().union(*providers.values()) == set()


def test_every_package_is_typed():
    assert all((ROOT / name / "py.typed").is_file() for name in PACKAGES)


def test_the_container_takes_what_there_is():
    from test_readme import parse_angie

    lines = (ROOT / "Dockerfile").read_text().splitlines()
    words = [line.split() for line in lines if re.match(r"[A-Z]+ ", line)]
    copied = [name for line in words if line[0] == "COPY" for name in line[1:-1]]
    assert all((ROOT / name).exists() for name in copied) and set(PACKAGES) <= set(copied)
    assert {"pyproject.toml", "README.md", "LICENSE"} <= set(copied)  # the wheel is built of them
    (command,) = (line for line in lines if line.startswith("CMD "))
    program, *arguments = json.loads(command.removeprefix("CMD "))
    assert program == "angie"
    parse_angie(arguments)
