#!/usr/bin/env bash
# Make the bundle, the photo and the recording that ship in angie/default, from nothing.
#   bash scripts/train_default.sh WORK     about an hour on two cores; run again, it goes on
set -euo pipefail
work="${1:?folder to work in}"
here="$(cd "$(dirname "$0")" && pwd)"
mkdir -p "$work"
[ -d "$work/raw" ] || angie phantom -o "$work/raw" --minutes 10 --presenters 16 --seed 1
[ -d "$work/data" ] || angie prepare "$work/raw" -o "$work/data"
angie train "$work/data" -o "$work/bundle" --preset lite --resume \
  renderer.generator.width=64 renderer.generator.bottleneck_blocks=4 \
  train_renderer.steps=4000 train_renderer.batch=4 train_renderer.rate=4e-4 \
  train_renderer.sheet_every=250
python "$here/ship_default.py" "$work/bundle"
