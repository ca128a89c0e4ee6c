#!/bin/sh
# Builds a wheel, installs it into an empty environment and runs the demo there from another folder.
set -eu
python=$1
source=$(pwd)
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
"$python" -m venv "$scratch/venv"
"$scratch/venv/bin/pip" wheel --quiet --no-deps --wheel-dir "$scratch" "$source"
"$scratch/venv/bin/pip" install --quiet "$scratch"/saltus-*.whl
cd "$scratch"
"$scratch/venv/bin/saltus" demo --no-video --json --out "$scratch/run"
test -s "$scratch/run/recording.mcap" && test -s "$scratch/run/report.html"
echo "wheel: 1 passed, 0 failed"
