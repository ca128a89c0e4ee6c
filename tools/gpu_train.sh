#!/usr/bin/env bash
# Trains the motion policy on a machine with GPUs that reaches no package index.
# usage: tools/gpu_train.sh WHEELS OUT [flags of saltus policy train]
# WHEELS: a folder of wheels to put beside what python3 has, or "" where they are installed: mujoco, mujoco-core,
#   mujoco-warp, warp-lang, etils, absl-py, glfw, pyopengl, rsl-rl-lib, tensordict, pyvers, cloudpickle, gitpython,
#   gitdb, smmap, array-api-compat, tomli-w, tyro, docstring-parser, typeguard; daqp, without which the training is not
#   evaluated with the deployed stack; kornia, kornia-rs, for trainings of the heightmap network with the same wheels.
# Expected in python3: torch, numpy, scipy, tensorboard, tqdm; for that evaluation also onnx and onnxruntime.
# OUT gets at most eight files, of which checkpoint.pt (5 MB) is the largest. Take the folder along; the next machine
# goes on from it, in the same folder or in another, and continues log.txt, progress.csv and evaluation.csv:
#   tools/gpu_train.sh WHEELS OUT --resume OUT/checkpoint.pt --minutes 8 --commit COMMIT
# (COMMIT: of the code, as such a machine seldom has the repository.) A policy is exported elsewhere.
# With GPUS=N in the environment N GPUs of this machine learn together.
set -euo pipefail
if [ $# -lt 2 ]; then sed -n 2,15p "$0" >&2; exit 2; fi
wheels=$1; out=$2; shift 2
site=${SITE:-/tmp/site}
if [ -n "$wheels" ]; then
  python3 -m pip install -q --no-index --no-deps --no-compile --no-cache-dir --upgrade --target "$site" "$wheels"/*.whl
fi
export PYTHONPATH=$site:$PWD PYTHONUNBUFFERED=1 PYTHONWARNINGS=ignore
export TORCHINDUCTOR_CACHE_DIR=${TORCHINDUCTOR_CACHE_DIR:-/tmp/inductor}
if [ "${GPUS:-1}" -gt 1 ]; then
  run=(python3 -m torch.distributed.run --standalone --nproc_per_node "$GPUS" -m saltus.cli.policy_train)
else
  run=(python3 -m saltus.cli.policy_train)
fi
exec "${run[@]}" --out "$out" "$@"
