"""Runs one process of the stack in the foreground."""

import subprocess
import sys
from pathlib import Path


def serve(module: str, run_dir: Path, endpoint: str) -> int:
    """Runs `python -m module` against a router and returns its exit code; Ctrl-C reaches it and ends it."""
    command = [sys.executable, "-m", module, "--run-dir", str(run_dir), "--endpoint", endpoint]
    return subprocess.run(command, check=False).returncode
