#!/bin/sh
# Makes the virtual environment: python.sh PYTHON VENV. Installs Debian's python3-venv when it may and must.
set -eu
python=$1
venv=$2
command -v "$python" >/dev/null 2>&1 || { echo "'$python' not found: install Python 3.11 or 3.12, or say make PYTHON=..." >&2; exit 1; }
"$python" - <<'CHECK' || exit 1
import sys
if not (3, 11) <= sys.version_info[:2] <= (3, 12):
    sys.exit(f"Python 3.11 or 3.12 is needed, this is {sys.version.split()[0]}: say make PYTHON=python3.11")
CHECK
if ! "$python" -c 'import ensurepip' 2>/dev/null; then
    line="apt-get install -y --no-install-recommends python3-venv"
    if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null 2>&1; then
        apt-get update -q && $line
    elif command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null; then
        sudo apt-get update -q && sudo $line
    else
        echo "Python's venv is missing. Please type:  sudo $line" >&2
        exit 1
    fi
fi
[ -x "$venv/bin/python" ] || "$python" -m venv "$venv"
