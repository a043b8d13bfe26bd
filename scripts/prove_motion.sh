#!/usr/bin/env bash
# Train the motion side on 70 minutes of phantom and measure what it claims: codes, hearing, FGD and
# beats against baselines, the paper's ablations, calm in silence, long sound.
#   bash scripts/prove_motion.sh WORK RENDERER     hours on one core; run again, it goes on
# RENDERER is a bundle with a trained renderer (lite, 20 regions); its regions are used as they are.
# WORK/raw and WORK/set are made unless they are there (links will do). Needs angie installed, or
# the repository in PYTHONPATH and ANGIE="python -m angie".
set -euo pipefail
work="${1:?folder to work in}" renderer="${2:?bundle with a trained renderer}"
here="$(cd "$(dirname "$0")" && pwd)"
angie() { ${ANGIE:-command angie} "$@"; }
python="${PYTHON:-python}" set="$work/set"
# what differs from the settings that RENDERER was made with
settings=(vq.restart_below=0.1)
joint=(gpt.joint=true)
own=(train_vq.schedule.most_steps=1500 train_gpt.schedule.most_steps=800
     train_refiner.schedule.most_steps=600)

mkdir -p "$work"
[ -d "$work/raw" ] || angie phantom -o "$work/raw" --minutes 70 --seed 0
[ -d "$set" ] || angie prepare "$work/raw" -o "$set"

measured() {  # BUNDLE FROM ARGUMENTS...: a bundle with FROM's renderer and the motion of the set
  [ ! -f "$work/$1/statistics.safetensors" ] || return 0
  rm -rf "${work:?}/$1"
  cp -r "$2" "$work/$1"
  angie train "$set" -o "$work/$1" --stage motion "${@:3}"
}
learnt() {  # BUNDLE SEED: its motion stages
  for stage in vq gpt refiner; do
    [ -f "$work/$1/$stage.safetensors" ] ||
      angie train "$set" -o "$work/$1" --stage "$stage" --seed "$2" --resume
  done
}

measured base "$renderer" "${settings[@]}"
for seed in 0 1 2; do
  measured "joint-$seed" "$work/base" "${joint[@]}"
  learnt "joint-$seed" "$seed"
done
for name in adam bella carl dora; do
  measured "$name" "$work/base" --speaker "$name" "${own[@]}"
  learnt "$name" 0
done
