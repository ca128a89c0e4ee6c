#!/usr/bin/env bash
# Trains the heightmap network on a machine with a GPU that reaches no package index, a portion at a time.
# usage: [START=CHECKPOINT] tools/gpu_heightmap.sh WHEELS OUT SEED PORTION COMMIT POLICY.pt ...
# WHEELS, COMMIT: as of tools/gpu_train.sh. Expected in python3 besides: h5py.
# Portion 0 begins from nothing, on robots that see heights as in their policy's training. Each later one begins with
# START, the checkpoint that the portion before it left in its OUT, which also is in the loop of its robots. Every policy
# drives three quarters of the robots of a shard, rules drive the others; the families of courses are those of TERRAINS.
# Each portion draws its own data, from SEED and PORTION; they stay on that machine, as do the shards of a portion that
# was interrupted: the same command goes on there. Take OUT along: heightmap.pt (7 MB; of the shipped sizes 16) and manifest.json, for
#   saltus heightmap export --data OUT --checkpoint OUT/heightmap.pt --unseen DATASET
# A portion of two policies takes 9 minutes of an H100 or H200: compilation and 4.6 million steps of each policy 4,
# 15,000 updates of the shipped sizes 5.
set -euo pipefail
if [ $# -lt 6 ]; then sed -n 2,12p "$0" >&2; exit 2; fi
wheels=$1; out=$2; seed=$3; portion=$4; commit=$5; shift 5
site=${SITE:-/tmp/site}; device=${DEVICE:-cuda}; data=${DATA:-/tmp/heightmap_data}/$seed-$portion
if [ "$portion" -gt 0 ] && [ ! -f "${START:-}" ]; then echo "portion $portion needs START, a checkpoint" >&2; exit 2; fi
if [ -n "$wheels" ]; then
  python3 -m pip install -q --no-index --no-deps --no-compile --no-cache-dir --upgrade --target "$site" "$wheels"/*.whl
fi
export PYTHONPATH=$site:$PWD PYTHONUNBUFFERED=1 PYTHONWARNINGS=ignore
export TORCHINDUCTOR_CACHE_DIR=${TORCHINDUCTOR_CACHE_DIR:-/tmp/inductor}
# More of what is hard to see or to be sure of: stairs and stones, ditches of any depth, and what is no course.
terrains=${TERRAINS:-flat stairs stairs stepping_stones stepping_stones step gap stairs_down step_down pyramid irregular
  hurdles ditch ditch ditch ramp_up ramp_up ramp_down clutter clutter clutter clutter clutter clutter clutter clutter}
# Of the network, as flags of `saltus heightmap train`; SIZES= for the default, which a model that is shipped may have.
sizes=${SIZES---model.channels 16 32 32 --model.hidden 384}
mkdir -p "$data" "$out"
shard=0
for policy in "$@"; do
  if [ ! -f "$data/round_$(printf %03d $shard).h5" ]; then
    # shellcheck disable=SC2086 # one word a family
    python3 -m saltus.cli.main heightmap collect gpu --device "$device" --policy "$policy" --out "$data" \
      --seed $((1000000 * seed + 100 * portion + shard)) --episodes "${EPISODES:-8192}" ${START:+--predictor "$START"} \
      --loop.robots "${ROBOTS:-4096}" --loop.ticks "${TICKS:-600}" --loop.learned 0.75 --loop.terrains $terrains \
      --commit "$commit" --json
  fi
  shard=$((shard + 1))
done
cp "$data/manifest.json" "$out/"
# shellcheck disable=SC2086 # words of the sizes
python3 -m saltus.cli.main heightmap train --data "$data" --out "$out" --updates "${UPDATES:-15000}" --batch "${BATCH:-128}" \
  --seed "$seed" --device "$device" ${START:+--start "$START"} $sizes
