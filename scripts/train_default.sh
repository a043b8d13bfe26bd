#!/usr/bin/env bash
# Make the bundle, the photo and the recording that ship in angie/default, from nothing.
#   bash scripts/train_default.sh WORK     about an hour on two cores; run again, it goes on
# The regions are taught the phantom's joints first (see teach_regions.py), then kept; flow, image
# generator and all that concerns motion are trained as ever.
# The bundle that ships was stopped and resumed with other warm-up settings on the way (pairs of any
# distance, then of 50 and 25 frames, then the blend of pictures), so this recipe gives one like it,
# not the same one.
set -euo pipefail
work="${1:?folder to work in}"
here="$(cd "$(dirname "$0")" && pwd)"
sizes=(renderer.generator.width=64 renderer.generator.bottleneck_blocks=4)
mkdir -p "$work"
[ -d "$work/raw" ] || angie phantom -o "$work/raw" --minutes 10 --presenters 16 --seed 1
[ -d "$work/data" ] || angie prepare "$work/raw" -o "$work/data"
[ -f "$work/taught.safetensors" ] ||
  python "$here/teach_regions.py" "$work/raw" "$work/data" "$work/taught.safetensors" "${sizes[@]}"
angie train "$work/data" -o "$work/bundle" --preset lite --resume "${sizes[@]}" \
  train_renderer.initial="$work/taught.safetensors" train_renderer.freeze_estimator=true \
  train_renderer.warmup_steps=1900 train_renderer.warmup_gap=0 \
  train_renderer.rate=1e-3 "train_renderer.milestones=[0.6, 0.9]" \
  train_renderer.steps=220 train_renderer.batch=4 train_renderer.sheet_every=100 \
  train_vq.schedule.most_steps=500 train_gpt.schedule.most_steps=400 train_gpt.checks=20 \
  train_refiner.schedule.most_steps=300 train_refiner.checks=15
python "$here/ship_default.py" "$work/bundle"
