"""Lets an identifier look at every log, and seals what it says before anyone opens the truth."""

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

Find = Callable[[tuple[Path, ...], Path], None]
"""From the directories of logs of one robot and one for results; writes verdict.json there."""
LIMIT_S = 600.0
"""Time limit of one log: the time that sixty seconds of log may take on two cores."""
ENDINGS = (signal.SIGHUP, signal.SIGINT, signal.SIGTERM)
"""Signals by which somebody ends a command and means the benchmark: the log keeps no verdict, and
is looked at the next time."""


def identify(logs: Path, verdicts: Path, find: Find, jobs: int, second: Path | None = None) -> int:
    """Writes a verdict for every log that has none yet, then the hashes of all.

    Returns how many there are.

    With second logs those robots are looked at that have one, in both together.

    A log that cannot be finished gets the verdict "error", which counts as wrong.
    """
    names = sorted(path.name for path in logs.iterdir() if (path / "meta.json").exists())
    if second is not None:
        names = [name for name in names if (second / name / "meta.json").exists()]
    folders = (logs,) if second is None else (logs, second)
    open_ = [name for name in names if not (verdicts / name / "verdict.json").exists()]
    print(f"{len(names) - len(open_)} of {len(names)} verdicts are there", flush=True)
    with ThreadPoolExecutor(jobs) as pool:
        futures = {
            pool.submit(_look, find, tuple(f / name for f in folders), verdicts / name): name
            for name in open_
        }
        try:
            for number, future in enumerate(
                as_completed(futures), start=len(names) - len(open_) + 1
            ):
                print(f"{number}/{len(names)} {futures[future]}: {future.result()}", flush=True)
        finally:  # who is interrupted waits for the logs that are being looked at, not for all
            pool.shutdown(wait=False, cancel_futures=True)
    hashes = {name: digest(verdicts / name / "verdict.json") for name in names}
    verdicts.mkdir(parents=True, exist_ok=True)
    (verdicts / "hashes.json").write_text(json.dumps(hashes, indent=1), encoding="utf-8")
    return len(names)


def digest(path: Path) -> str:
    """SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def command(logs: tuple[Path, ...], out: Path) -> None:
    """Finds with the project's command line, in a process of its own on one core."""
    find = [
        sys.executable,
        "-P",
        "-m",
        "saltus.cli.main",
        "real2sim",
        "find",
        *map(str, logs),
        "--out",
        str(out),
    ]
    call = [*find, "--json", "--no-report"]
    done = subprocess.run(
        call,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
        check=False,
        encoding="utf-8",
    )
    if -done.returncode in ENDINGS:
        raise KeyboardInterrupt
    if not (out / "verdict.json").exists():
        raise RuntimeError(f"exit code {done.returncode}: {done.stderr[-2000:]}")


def _look(find: Find, logs: tuple[Path, ...], out: Path) -> str:
    out.mkdir(parents=True, exist_ok=True)
    start = time.monotonic()
    try:
        find(logs, out)
    except Exception as error:  # whatever stops an identifier must not stop the benchmark
        (out / "verdict.json").write_text(
            json.dumps({"verdict": "error", "message": str(error)}), encoding="utf-8"
        )
    seconds = time.monotonic() - start
    (out / "seconds.json").write_text(json.dumps(seconds), encoding="utf-8")
    said = json.loads((out / "verdict.json").read_text(encoding="utf-8"))
    return (
        f"{said['verdict']} "
        f"{[effect['name'] for effect in said.get('effects', [])]} {seconds:.0f} s"
    )
