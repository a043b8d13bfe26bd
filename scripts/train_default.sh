#!/usr/bin/env bash
# Make the bundle, the photo and the recording that ship in angie/default, from nothing.
#   bash scripts/train_default.sh WORK [SIGNER AVATARS MODELS]
# Many hours on two cores; run again, it goes on. With the folders of other people's videos and of
# the networks that see hands, the pictures are trained on a GPU at last (see train_on_gpu.sh).
# Regions and masks are taught the joints of 16 phantoms first (angie teach), a slim
# renderer is trained with them, then the deep one: 1800 steps in which the regions learn without
# labels on 20 minutes of four phantoms, 1200 in which they rest on 70 minutes. Motion is learnt from
# 116 other minutes, as in prove_motion.sh.
set -euo pipefail
work="${1:?folder to work in}"
here="$(cd "$(dirname "$0")" && pwd)"
export OMP_WAIT_POLICY=PASSIVE
slim=(renderer.generator.design=lite renderer.generator.width=64 renderer.generator.bottleneck_blocks=4)
jitter=(hue=0.3 contrast=0.3 saturation=0.8 brightness=0.2)
common=(train_renderer.warmup_steps=0 train_renderer.batch=4 train_renderer.blend=0.5
  train_renderer.sheet_every=250 "${jitter[@]/#/train_renderer.augmentation.}"
  renderer.generator.refine_blocks=2 renderer.generator.half_blocks=0
  renderer.generator.fine_occlusion=false)

videos() { # NAME MINUTES PRESENTERS SEED
  [ -d "$work/raw$1" ] ||
    angie phantom -o "$work/raw$1" --minutes "$2" --presenters "$3" --seed "$4"
  [ -d "$work/data$1" ] || angie prepare "$work/raw$1" -o "$work/data$1"
}

renderer() { # DATA BUNDLE SETTINGS
  local data="$1" bundle="$2"
  shift 2
  [ -f "$work/$bundle/renderer.safetensors" ] && return
  angie train "$work/$data" -o "$work/$bundle" --stage renderer --preset lite --resume \
    "${common[@]}" "$@"
}

mkdir -p "$work"
videos 16 10 16 1
videos 20 20 4 0
videos 70 70 4 0
videos 116 116 4 1
[ -f "$work/taught.safetensors" ] ||
  angie teach "$work/data16" -o "$work/taught.safetensors" --truth "$work/raw16" --resume "${slim[@]}"
renderer data16 slim "${slim[@]}" train_renderer.initial="$work/taught.safetensors" \
  train_renderer.freeze_estimator=true train_renderer.steps=2600 train_renderer.rate=4e-4 \
  "train_renderer.milestones=[0.6, 0.9]" train_renderer.occlusion_cost=2 \
  train_renderer.augmentation.zoom=0.5
[ -f "$work/masks.safetensors" ] ||
  python "$here/refit_renderer.py" "$work/slim/renderer.safetensors" "$work/masks.safetensors" \
    renderer.generator.refine_blocks=2 renderer.generator.half_blocks=0 \
    renderer.generator.fine_occlusion=false
renderer data20 regions train_renderer.initial="$work/masks.safetensors" \
  train_renderer.steps=1800 train_renderer.rate=5e-4 "train_renderer.milestones=[0.89]" \
  train_renderer.equivariance_shift=4 train_renderer.augmentation.zoom=0.1
renderer data70 bundle train_renderer.initial="$work/regions/renderer.safetensors" \
  train_renderer.freeze_estimator=true train_renderer.steps=1200 train_renderer.rate=5e-4 \
  "train_renderer.milestones=[0.85]" train_renderer.occlusion_cost=0.5 train_renderer.ema=0.99 \
  train_renderer.augmentation.zoom=0.3
[ -f "$work/bundle/angie.vq.safetensors" ] ||
  angie train "$work/data116" -o "$work/bundle" --stage vq --resume gpt.joint=true \
  train_vq.schedule.most_steps=6000 train_vq.checks=6 train_gpt.schedule.most_steps=1800 \
  train_gpt.checks=18 train_gpt.patience=4 train_refiner.checks=10
[ -f "$work/bundle/angie.gpt.safetensors" ] ||
  angie train "$work/data116" -o "$work/bundle" --stage gpt --resume
[ -f "$work/bundle/angie.refiner.safetensors" ] ||
  angie train "$work/data116" -o "$work/bundle" --stage refiner --resume
[ -f "$work/bundle/tricon.generator.safetensors" ] ||
  angie train "$work/data116" -o "$work/bundle" --resume --generator tricon
shipped="$work/bundle"
if [ $# -ge 4 ]; then
  videos 9 9 18 11
  shipped="$work/pictures"
  [ -f "$work/packed/natural.safetensors" ] ||
    bash "$here/train_on_gpu.sh" pack "$work/packed" "$2" "$3" "$work/raw9" "$4" "$work/bundle"
  [ -f "$work/drawn/final.safetensors" ] || LIMIT=560 \
    bash "$here/train_on_gpu.sh" train "$work/packed" "$work/drawn" --refine 8 --rate 0.0012
  [ -d "$shipped" ] ||
    python "$here/replace_renderer.py" "$work/bundle" "$work/drawn/final.safetensors" "$shipped"
  [ -f "$work/pictures.md" ] || { # people whom no training has seen
    python "$here/check_pictures.py" "signer=$2" "avatars=$3" "phantom=$work/raw9" --models "$4" \
      --renderer before="$work/bundle" --renderer after="$shipped" --sheet "$work/sheets" \
      >"$work/pictures.md.part"
    mv "$work/pictures.md.part" "$work/pictures.md"
  }
fi
python "$here/ship_default.py" "$shipped"
