#!/bin/sh
# Builds a wheel of the checkout and one of the source distribution: each must have one top-level name and all modules.
# Installs the second into an empty environment and runs the demo there from another folder.
set -eu
python=$1
source=$(pwd)
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
"$python" -m venv "$scratch/build"
"$scratch/build/bin/pip" install --quiet build
for out in "--wheel --outdir $scratch/checkout" "--outdir $scratch/sdist"; do # without --wheel: by way of the sdist
    # shellcheck disable=SC2086
    "$scratch/build/bin/python" -m build $out "$source" >"$scratch/log" 2>&1 || { cat "$scratch/log" >&2; exit 1; }
done
"$python" tools/wheel_names.py "$source" "$scratch"/checkout/*.whl "$scratch"/sdist/*.whl
"$python" -m venv "$scratch/venv"
"$scratch/venv/bin/pip" install --quiet "$scratch"/sdist/*.whl
cd "$scratch"
"$scratch/venv/bin/saltus" demo --no-video --json --out "$scratch/run"
test -s "$scratch/run/recording.mcap" && test -s "$scratch/run/report.html"
echo "wheel: 1 passed, 0 failed"
