#!/usr/bin/env bash
# Make a virtual environment, install angie, and make a video of the photo and speech it ships.
#   VENV=path   where the environment is made (default .venv)
set -euo pipefail
cd "$(dirname "$0")/.."
venv="${VENV:-.venv}"
[ -x "$venv/bin/python" ] || python3 -m venv "$venv"
"$venv/bin/python" -m pip install --quiet --upgrade-strategy only-if-needed .
"$venv/bin/angie" demo --force "$@"
