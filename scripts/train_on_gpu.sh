#!/usr/bin/env bash
# Train the shipped renderer's pictures on a GPU, in nine minutes, from one packed folder.
#   bash scripts/train_on_gpu.sh pack PACKED SIGNER AVATARS PHANTOM MODELS [BUNDLE]   here, on CPUs
#   bash scripts/train_on_gpu.sh smoke PACKED OUT                                    there, two minutes
#   bash scripts/train_on_gpu.sh train PACKED OUT [option ...]                       there, nine minutes
# PACKED gets all that the other machine needs but Python with torch, kornia, OpenCV, safetensors:
# frames, weights and this code (at most 64 MiB). OUT gets at most eight files of 16 MiB.
set -euo pipefail
mode="${1:?pack, smoke or train}" packed="${2:?folder with everything packed}"
here="$(cd "$(dirname "$0")" && pwd)"
shift 2

if [ "$mode" = pack ]; then
  signer="$1" avatars="$2" phantom="$3" models="$4" frames="$packed/frames"
  mkdir -p "$frames" "$packed/code/scripts"
  pack() { # KIND FOLDER STRIDE
    [ -f "$frames/$1.npz" ] ||
      python "$here/pack_frames.py" "$1" "$2" "$frames" --stride "$3" --models "$models"
  }
  pack signer "$signer" 10
  pack avatars "$avatars" 5
  pack phantom "$phantom" 7
  python "$here/draw_backgrounds.py" "$frames"
  python "$here/pack_weights.py" "$packed" ${5:+--bundle "$5"}
  python "$here/pack_hands.py" "$models/hand_landmark_full.tflite" "$packed/hands.safetensors"
  cp -r "$here/../mraa" "$here/../data_prep" "$packed/code"
  cp -r "$here"/{train_on_gpu.py,train_on_gpu.sh,pictures} "$packed/code/scripts"
  find "$packed/code" -name __pycache__ -prune -exec rm -r {} +
  du -sh "$packed"
  exit
fi

out="${1:?folder for what comes out}"
shift
export PYTHONPATH="$here/..:$here" PYTHONUNBUFFERED=1 TORCHINDUCTOR_CACHE_DIR="${TMPDIR:-/tmp}/inductor"
command=(python3 "$here/train_on_gpu.py" "$packed/frames" "$packed/initial.safetensors")
nets=(--natural "$packed/natural.safetensors")
[ -f "$packed/hands.safetensors" ] && nets+=(--hands "$packed/hands.safetensors")
mkdir -p "$out"
case "$mode" in
  smoke) # speed and first gains of some settings; their weights are thrown away
    scratch="$(mktemp -d)"
    trials='[{"span": 25}, {"span": 20, "batch": 64, "rate": 0.001}, {"span": 20, "rate": 0.0015}]'
    timeout "${LIMIT:-180}" "${command[@]}" "$scratch" "${nets[@]}" \
      --check 100 --trials "${TRIALS:-$trials}" "$@" 2>&1 | tee "$out/smoke.txt" || true
    for trial in "$scratch"/trial*; do
      cp "$trial/final.png" "$out/$(basename "$trial").png" 2>/dev/null || true
    done
    ;;
  train)
    exec "${command[@]}" "$out" "${nets[@]}" --seconds "${LIMIT:-525}" "$@" 2>&1
    ;;
  *) echo "pack, smoke or train" >&2 && exit 2 ;;
esac
