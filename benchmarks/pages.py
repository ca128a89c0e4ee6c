"""The commands of the pages, run as a reader would:
page by page, each in a folder of its own, in their order.

    saltus bench pages
    saltus bench pages -- --pages docs/tutorials/log.md docs/tutorials/camera.md
    saltus bench pages -- --out runs/pages.jsonl

Beside `examples` and `models` such a folder holds what the page's commands make. What waits for
Ctrl-C runs beside what follows it, and is ended with the page. What cannot run here is listed with
what it lacks. With `--out` pages that are whole in that file are not run again.
"""

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks._command import Command, progress, tell
from benchmarks._measuring import hear_signals
from saltus.errors import ConfigError

ROOT = Path(__file__).parents[1]
BLOCK = re.compile(r"^```(?:sh)?\n(.*?)^```", re.DOTALL | re.MULTILINE)
PROGRAMS = ("saltus", "python", "pip", "make", "docker", "git", "tools/", "ros2", "export")
"""By which a line is a command, and not what one prints."""
LACKS = {
    r"pip |go2/|motor_response": "files from the internet",
    r"docker|git archive": "Docker, or a Debian root: docs/container.md says how it was tried",
    r"ros2 (run|topic)|export RMW|: saltus ros2 --run-dir runs/one$": "ROS 2",
    r": make ": "a fresh clone: that is what is checked before each change",
    r"gpu_train|paper train|collect gpu|runs/(second|all|dagger|paper-train|heightmap/)|policy.md": "a GPU",
    r"real2sim cycle|cycle.md: ": "hours, or a GPU: its figures are in docs/cycle.md",
    r"mine\.xml|logs/mine|my_robot|hidden\.toml": "files of the reader",
    r"listen 192\.168\.|--run-dir copy|--run-dir runs/mine --take": "another computer",
    r"reliability.md: .* runs/mine": "a run that another page starts",
}
"""Why a command is not run, by a part of its page and itself."""
WAITS = re.compile(
    r"saltus (router|up|watch|record run|ros2|heightmap serve|demo --pace realtime)|own_robot\.py"
)
"""Commands that run until they are ended, or beside what the page starts in other terminals."""
SETTLED_S = 20.0
"""How long what waits is given to say that it has begun, or to fail."""
END_S = 30.0
POLL_S = 0.5
ASKED = (130, -signal.SIGINT)
"""Exit codes of what was ended by Ctrl-C."""
FAILED = 2
"""Exit code from which on a command has failed; 1 without a traceback is a verdict, as of a robot
that fell."""

Row = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    pages: tuple[Path, ...] = ()
    """Files; by default all pages, the README and the models' cards."""
    limit_s: float = 1800.0
    """For one command."""
    out: Path | None = None
    """File of rows so far, to go on from."""

    def measure(self) -> dict[str, Any]:
        for page in self.pages:
            if not page.is_file():
                raise ConfigError(f"{page}: no such page")
        pages = self.pages or (
            *sorted(ROOT.glob("docs/**/*.md")),
            ROOT / "README.md",
            *sorted(ROOT.glob("models/*.md")),
        )
        known = (
            self.out.read_text(encoding="utf-8").splitlines()
            if self.out is not None and self.out.is_file()
            else []
        )
        rows: list[Row] = [json.loads(line) for line in known]
        done = {row["page"] for row in rows}
        for page in progress([page for page in pages if commands(page)], "pages"):
            name = os.path.relpath(page.resolve(), ROOT)
            if name in done:
                continue
            found = [{"page": name, **row} for row in self._run(page, name)]
            rows += found
            if self.out is not None:
                with self.out.open("a", encoding="utf-8") as file:
                    file.writelines(json.dumps(row) + "\n" for row in found)
        return {
            "commands": len(rows),
            "ran": sum("code" in row for row in rows),
            "failed": [
                f"{row['page']}: {row['command']}: {row['code']}"
                for row in rows
                if row.get("failed")
            ],
            "not_run": dict(Counter(row["lacks"] for row in rows if "lacks" in row)),
            "minutes": sum(row.get("seconds", 0.0) for row in rows) / 60.0,
        }

    def _run(self, page: Path, name: str) -> Iterator[Row]:
        with tempfile.TemporaryDirectory() as scratch:
            folder = Path(scratch)
            for shipped in ("examples", "models"):
                (folder / shipped).symlink_to(ROOT / shipped)
            path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
            environment = {**os.environ, "PATH": path, "HOME": scratch}
            waiting: list[tuple[Row, subprocess.Popen[bytes], Path]] = []
            try:
                for number, command in enumerate(commands(page)):
                    lacks = next(
                        (
                            why
                            for part, why in LACKS.items()
                            if re.search(part, f"{name}: {command}")
                        ),
                        None,
                    )
                    if lacks is not None:
                        yield {"command": command, "lacks": lacks}
                        continue
                    log = folder / f"{number}.log"
                    begun_s = time.monotonic()
                    process = begun(command, log, cwd=folder, env=environment)
                    waits = WAITS.search(command) is not None
                    code = ended(process, SETTLED_S, log) if waits else ended(process, self.limit_s)
                    row = {"command": command, "seconds": round(time.monotonic() - begun_s, 1)}
                    if waits and code is None:
                        waiting.append((row, process, log))
                    else:
                        yield told(row, code if code is not None else stopped(process), log)
            finally:
                last = [(row, stopped(process), log) for row, process, log in reversed(waiting)]
            yield from (told(row, 0 if code in ASKED else code, log) for row, code, log in last)


def commands(page: Path) -> list[str]:
    """The commands of a page, in order, without their comments."""
    text = re.sub(r"\\\n\s*", "", page.read_text(encoding="utf-8"))
    lines = [line.strip() for block in BLOCK.findall(text) for line in block.splitlines()]
    return [re.sub(r"\s+# .*", "", line) for line in lines if line.startswith(PROGRAMS)]


def begun(command: str, log: Path, *, cwd: Path, env: dict[str, str]) -> subprocess.Popen[bytes]:
    """Starts a command, in a session of its own: it and what it starts can be ended together."""
    with log.open("wb") as file:
        return subprocess.Popen(
            ["/bin/bash", "-c", f"exec {command}"],
            stdin=subprocess.DEVNULL, stdout=file, stderr=file, start_new_session=True,
            preexec_fn=hear_signals,
            cwd=cwd, env=env,
        )  # fmt: skip


def ended(process: subprocess.Popen[bytes], limit_s: float, log: Path | None = None) -> int | None:
    """Its exit code; None where it still runs after so long,
    or has said something in its log and still runs.
    """
    until_s = time.monotonic() + limit_s
    while process.poll() is None and time.monotonic() < until_s:
        time.sleep(POLL_S)
        if log is not None and log.stat().st_size and process.poll() is None:
            return None
    return process.returncode


def stopped(process: subprocess.Popen[bytes]) -> int:
    """Ends a command as Ctrl-C does, and what it started with it; returns its exit code."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGINT)
    code = ended(process, END_S)
    if code is None:
        os.killpg(process.pid, signal.SIGKILL)
        code = process.wait()
    return code


def told(row: Row, code: int, log: Path) -> Row:
    """The row with its exit code, told on the way; where it failed with what it said last."""
    said = log.read_text(errors="replace", encoding="utf-8")
    failed = code >= FAILED or code < 0 or "Traceback (most recent call last)" in said
    tell(f"{code:4d} {row['seconds']:7.1f} s  {row['command']}")
    if failed:
        tell(said[-500:])
    return {**row, "code": code, "failed": failed}
