#!/usr/bin/env bash
# Make the bundle, the photo and the recording that ship in angie/default, from nothing.
#   bash scripts/train_default.sh WORK     hours on two cores; run again, it goes on
# Regions and masks are taught the phantom's joints first (see teach_renderer.py); the regions are
# then kept, and flow, image generator and all that concerns motion are trained as ever.
set -euo pipefail
work="${1:?folder to work in}"
here="$(cd "$(dirname "$0")" && pwd)"
export OMP_WAIT_POLICY=PASSIVE
sizes=(renderer.generator.width=64 renderer.generator.bottleneck_blocks=4)
jitter=(zoom=0.5 hue=0.3 contrast=0.3 saturation=0.8 brightness=0.2)
mkdir -p "$work"
[ -d "$work/raw" ] || angie phantom -o "$work/raw" --minutes 10 --presenters 16 --seed 1
[ -d "$work/data" ] || angie prepare "$work/raw" -o "$work/data"
[ -f "$work/taught.safetensors" ] ||
  python "$here/teach_renderer.py" "$work/raw" "$work/data" "$work/taught.safetensors" "${sizes[@]}"
angie train "$work/data" -o "$work/bundle" --preset lite --resume "${sizes[@]}" \
  train_renderer.initial="$work/taught.safetensors" train_renderer.freeze_estimator=true \
  train_renderer.warmup_steps=0 train_renderer.steps=2600 train_renderer.batch=4 \
  train_renderer.rate=4e-4 "train_renderer.milestones=[0.6, 0.9]" train_renderer.sheet_every=200 \
  train_renderer.occlusion_cost=2 train_renderer.blend=0.5 "${jitter[@]/#/train_renderer.augmentation.}" \
  train_vq.schedule.most_steps=1500 train_gpt.schedule.most_steps=800 train_gpt.checks=20 \
  train_refiner.schedule.most_steps=600 train_refiner.checks=15
python "$here/ship_default.py" "$work/bundle"
