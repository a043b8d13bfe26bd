#!/usr/bin/env bash
# Make a virtual environment, install angie with what its tests need, and run every check.
#   VENV=path   where the environment is made (default .venv-test)
set -euo pipefail
cd "$(dirname "$0")/.."
venv="${VENV:-.venv-test}"
[ -x "$venv/bin/python" ] || python3 -m venv "$venv"
"$venv/bin/python" -m pip install --quiet --upgrade-strategy only-if-needed -e '.[app,dev]'
"$venv/bin/ruff" check .
"$venv/bin/ruff" format --check .
"$venv/bin/mypy"
"$venv/bin/python" -m pytest -n 2 --dist worksteal "$@"
