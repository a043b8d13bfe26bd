#!/usr/bin/env bash
# Train the motion side on 116 minutes of phantom and measure what it claims: codes, hearing, FGD and
# beats against baselines, the paper's ablations, calm in silence, long sound.
#   bash scripts/prove_motion.sh WORK RENDERER     hours on one core; run again, it goes on
# RENDERER is a bundle with a trained renderer (lite, 20 regions); its regions are used as they are.
# WORK/raw and WORK/set are made unless they are there (links will do). ANGIE and PYTHON name the
# commands where the package is not installed, such as ANGIE="python -m angie".
#   SEEDS="0 1 2"     training seeds of the joint model
#   SPEAKERS="adam bella carl dora"     models of one speaker
#   VARIANTS=full,...  rows of the ablations
#   TRAININGS=3       seeds of training of the variants that the comparison stands on
set -euo pipefail
work="${1:?folder to work in}" renderer="${2:?bundle with a trained renderer}"
here="$(cd "$(dirname "$0")" && pwd)"
read -ra angie <<<"${ANGIE:-angie}"
read -ra python <<<"${PYTHON:-python}"
set="$work/set"
settings=(
  'train_renderer.initial=""' 'train_renderer.teacher=""'
  vq.update=ema vq.restart_below=0.1 vq.context=clip train_vq.stride=5 train_vq.warmup=0.15 train_vq.path_loss=0.3 train_vq.path_loss_norm=square
  "train_vq.schedule.milestones=[375,460]" train_vq.checks=6
  gpt.joint=true gpt.dropout=0.3 train_gpt.schedule.rate=1e-3 "train_gpt.schedule.milestones=[400]"
  train_gpt.stride=8 train_gpt.grids=8 train_gpt.checks=18 train_gpt.patience=4
  refiner.hidden=128 train_refiner.velocity=20 train_refiner.stride=16 train_refiner.checks=10
  train_refiner.schedule.rate=2e-3 "train_refiner.schedule.milestones=[80]"
  generation.window.move=slide generation.decode=auto generation.blend=hann
  generation.sampling.calm=true
)
joint=(
  train_vq.schedule.most_steps=6000 train_gpt.schedule.most_steps=1800
  train_refiner.schedule.most_steps=3000
)
single=(
  train_vq.schedule.most_steps=6000 train_vq.path_loss=0.6 train_gpt.schedule.most_steps=700
  train_refiner.schedule.most_steps=1500
)
variant=( # the same limits for all, and no loss that only some of them have
  train_vq.schedule.most_steps=3000 train_gpt.schedule.most_steps=1200 train_gpt.grids=1
  train_refiner.schedule.most_steps=1500 train_vq.path_loss=0
)

mkdir -p "$work"
[ -d "$work/raw" ] || "${angie[@]}" phantom -o "$work/raw" --minutes 116 --seed 1
[ -d "$set" ] || "${angie[@]}" prepare "$work/raw" -o "$set"

copied() { # BUNDLE: the renderer and the motion of the set, nothing learnt
  [ -d "$work/$1" ] && return
  rm -rf "$work/$1.part"
  cp -r "$work/base" "$work/$1.part"
  mv "$work/$1.part" "$work/$1"
}
learnt() { # BUNDLE SEED SETTINGS...: its motion stages
  for stage in vq gpt refiner; do
    [ -f "$work/$1/angie.$stage.safetensors" ] ||
      "${angie[@]}" train "$set" -o "$work/$1" --stage "$stage" --seed "$2" --resume "${@:3}"
  done
}

checked() { # NAME BUNDLES...: WORK/NAME.json, once it holds all of them
  [ -f "$work/$1.json" ] && return
  "${python[@]}" "$here/check_angie.py" "$set" "${@:2}" -o "$work/$1.part"
  mv "$work/$1.part" "$work/$1.json"
}

if [ ! -d "$work/base" ]; then
  rm -rf "$work/base.part"
  "${python[@]}" - "$renderer" "$work/base.part" <<'END'
import sys
from pathlib import Path

from angie.evaluation.ablation import copy_renderer
from angie.bundle import Bundle

source = Bundle.open(Path(sys.argv[1]))
copy_renderer(source, Path(sys.argv[2]), source.preset)
END
  mv "$work/base.part" "$work/base"
fi
[ -f "$work/base/statistics.safetensors" ] ||
  "${angie[@]}" train "$set" -o "$work/base" --stage motion
bundles=()
for seed in ${SEEDS-0 1 2}; do
  copied "joint-$seed"
  learnt "joint-$seed" "$seed" "${settings[@]}" "${joint[@]}"
  bundles+=("$work/joint-$seed")
done
checked check "${bundles[@]}"
[ -f "$work/report/results.json" ] ||
  "${angie[@]}" evaluate "$set" "${bundles[@]}" -o "$work/report" --seeds 3 --no-images \
    --fgd-steps 1000
[ -f "$work/ablations/table3.md" ] ||
  "${angie[@]}" ablate "$set" "$work/base" -o "$work/ablations" --fgd "$work/report/fgd-0.safetensors" \
    --seeds 3 --trainings "${TRAININGS-3}" --image-stride 24 ${VARIANTS:+--variants "$VARIANTS"} \
    "${settings[@]}" "${variant[@]}"
[ -f "$work/poses.txt" ] || # photos far from rest
  { "${python[@]}" "$here/check_poses.py" "$set" "${bundles[0]}" >"$work/poses.part" &&
    mv "$work/poses.part" "$work/poses.txt"; }
own=()
for name in ${SPEAKERS-adam bella carl dora}; do
  copied "$name"
  [ -f "$work/$name/angie.vq.safetensors" ] ||
    "${angie[@]}" train "$set" -o "$work/$name" --stage motion \
      --speaker "$name" gpt.joint=false
  learnt "$name" 0 "${settings[@]}" gpt.joint=false "${single[@]}"
  own+=("$work/$name")
done
if [ "${#own[@]}" -gt 0 ]; then
  checked check-own "${own[@]}" --minutes 0
  [ -f "$work/report-own/results.json" ] ||
    "${angie[@]}" evaluate "$set" "${own[@]}" -o "$work/report-own" --seeds 3 --no-images \
      --fgd "$work/report/fgd-0.safetensors"
fi
