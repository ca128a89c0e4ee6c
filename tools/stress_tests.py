"""Runs the tests so that what rests on their order, on each other or on an idle computer shows.

python tools/stress_tests.py                          # all three phases
python tools/stress_tests.py --phases alone --jobs 2  # each file of tests alone
python tools/stress_tests.py --only tests/saltus      # files below a folder, or one file
python tools/stress_tests.py --phases order --orders 1 --marks "not slow"  # one order of make test

Phases: `alone`, each file by itself; `order`, all files and the tests of each in random orders;
`busy`, all files beside programs that compute at normal priority. What passed is kept in
runs/stress_tests/done.json and not run again, however often this is interrupted; what failed is.
`--again` forgets what passed.
"""

import argparse
import contextlib
import json
import os
import random
import re
import signal
import subprocess
import sys
import threading
import time
import zlib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "runs" / "stress_tests"
DONE = FOLDER / "done.json"
PHASES = ("alone", "order", "busy")
PART = 68
"""Files of a random order in one process: as a worker of `make test` gets."""
LIMIT_S = 5400.0  # for a process; a part takes half an hour beside six busy programs
LOOP = "total = 0\nfor _ in range(20_000_000):\n    total += 1"
SPIN = "import os\nparent = os.getppid()\nwhile os.getppid() == parent:\n    sum(range(10**6))"
"""A busy program, which ends with who started it."""
RUNNING: set[int] = set()
"""Processes of pytest, each with a group of its own, which end with this one."""
NO_TESTS = 5
"""Exit status of pytest where the marks leave none of the files' tests."""
FAILURE = re.compile(r"^(?:FAILED|ERROR) (\S+)", re.MULTILINE)


@dataclass(frozen=True)
class Piece:
    """Files that one process of pytest runs."""

    name: str
    """Begins with the phase."""
    files: tuple[str, ...]
    seed: int | None = None
    """Seed of their order, None for the usual one."""
    marks: str = ""
    """Tests of these files that run, as `pytest -m` takes it; empty for all."""


@dataclass(frozen=True)
class Outcome:
    """The outcome of a piece."""

    passed: bool
    failed: list[str]
    """Tests; empty also where pytest itself did not come to its end."""
    processor_s: float
    """User and system time, with that of the processes that tests started and waited for."""
    wall_s: float
    commit: str


def pieces(
    phases: list[str],
    only: list[str],
    orders: int,
    times: int,
    marks: str = "",
    part: int = PART,
) -> list[Piece]:
    """The pieces to run, in their order."""
    files = [str(path.relative_to(ROOT)) for path in sorted((ROOT / "tests").rglob("test_*.py"))]
    files = [file for file in files if not only or any(file.startswith(each) for each in only)]
    found: list[Piece] = []
    where = f" of {zlib.crc32(' '.join(only).encode()):08x}" if only else ""
    if "alone" in phases:
        found += [Piece(f"alone {file}", (file,)) for file in files]
    if "order" in phases:
        for seed in range(orders):
            shuffled = random.Random(seed).sample(files, len(files))  # noqa: S311
            found += _parts(f"order {seed}", shuffled, where, part, seed)
    if "busy" in phases:
        for again in range(times):
            found += _parts(f"busy {again}", files, where, part)
    if marks:
        return [replace(each, name=f"{each.name} of {marks}", marks=marks) for each in found]
    return found


def _parts(
    name: str, files: list[str], where: str, size: int, seed: int | None = None
) -> Iterator[Piece]:
    sized = "" if size == PART else f" by {size}"
    for number, begin in enumerate(range(0, len(files), size)):
        part = tuple(files[begin : begin + size])
        yield Piece(f"{name} part {number}{sized}{where}", part, seed)


def run(piece: Piece, commit: str) -> Outcome:
    """Runs one piece; its output is in a file of its name."""
    log = FOLDER / f"{re.sub(r'[ /]', '-', piece.name)}.log"
    order = [] if piece.seed is None else ["--order", str(piece.seed)]
    chosen = ["-m", piece.marks] if piece.marks else []
    command = [sys.executable, "-m", "pytest", "-q", "-rfE", *order, *chosen, *piece.files]
    begun_s = time.monotonic()
    with log.open("w", encoding="utf-8") as said:
        both = {"stdout": said, "stderr": subprocess.STDOUT}
        process = subprocess.Popen(command, cwd=ROOT, start_new_session=True, **both)
        RUNNING.add(process.pid)
        end = threading.Timer(LIMIT_S, os.killpg, (process.pid, signal.SIGKILL))
        end.start()
        _, status, used = os.wait4(process.pid, 0)
        end.cancel()
        RUNNING.discard(process.pid)
    process.returncode = os.waitstatus_to_exitcode(status)
    return Outcome(
        passed=process.returncode in ((0, NO_TESTS) if piece.marks else (0,)),
        failed=FAILURE.findall(log.read_text(encoding="utf-8", errors="replace")),
        processor_s=round(used.ru_utime + used.ru_stime, 1),
        wall_s=round(time.monotonic() - begun_s, 1),
        commit=commit,
    )


@contextlib.contextmanager
def busy_programs(number: int) -> Iterator[None]:
    """So many programs compute meanwhile."""
    programs = [subprocess.Popen([sys.executable, "-c", SPIN]) for _ in range(number)]
    try:
        yield
    finally:
        for program in programs:
            program.kill()
            program.wait()


def reference_s() -> float:
    """Processor time of 20 million additions: by it those of two computers compare."""
    begun_s = time.process_time()
    exec(LOOP, {})  # noqa: S102 - among global names, as CONTRIBUTING.md states it
    return time.process_time() - begun_s


def read_done() -> dict[str, Outcome]:
    """The outcomes of earlier calls, by the name of their piece."""
    if not DONE.exists():
        return {}
    return {
        name: Outcome(**outcome)
        for name, outcome in json.loads(DONE.read_text(encoding="utf-8")).items()
    }


def write_done(done: dict[str, Outcome]) -> None:
    """Replaces the file as a whole: this may be interrupted at any time."""
    partial = DONE.with_suffix(".partial")
    partial.write_text(
        json.dumps({name: asdict(each) for name, each in done.items()}, indent=1), encoding="utf-8"
    )
    partial.replace(DONE)


def table(wanted: list[Piece], done: dict[str, Outcome]) -> str:
    """The pieces that passed, that did not, and that are not yet run."""
    lines = ["phase    pieces  passed  failed  left  processor s"]
    for phase in dict.fromkeys(piece.name.split()[0] for piece in wanted):
        names = [piece.name for piece in wanted if piece.name.split()[0] == phase]
        here = [done[name] for name in names if name in done]
        passed = sum(each.passed for each in here)
        used_s = sum(each.processor_s for each in here)
        counts = f"{len(names):6}  {passed:6}  {len(here) - passed:6}  {len(names) - len(here):4}"
        lines.append(f"{phase:7}  {counts}  {used_s:11.0f}")
    for piece in wanted:
        outcome = done.get(piece.name)
        if outcome is not None and not outcome.passed:
            what = outcome.failed or ["pytest did not come to its end"]
            lines += [f"failed: {piece.name}: {test}" for test in what]
    return "\n".join(lines)


def main() -> int:
    """Runs what the command line names and is not done; 1 where a test failed."""
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=plain)
    parser.add_argument("--phases", nargs="+", choices=PHASES, default=list(PHASES))
    parser.add_argument("--only", nargs="+", default=[], help="files or folders, as tests/saltus")
    parser.add_argument("--orders", type=int, default=3, help="random orders, of seeds 0, 1, ...")
    parser.add_argument("--times", type=int, default=3, help="runs beside busy programs")
    parser.add_argument("--marks", default="", help="as `pytest -m`: 'not slow' for make test")
    parser.add_argument("--part", type=int, default=PART, help="files of an order in one process")
    parser.add_argument("--programs", type=int, default=6, help="that are busy")
    parser.add_argument("--jobs", type=int, default=1, help="processes of pytest at once")
    parser.add_argument("--again", action="store_true", help="forget what passed")
    asked = parser.parse_args()
    FOLDER.mkdir(parents=True, exist_ok=True)
    wanted = pieces(asked.phases, asked.only, asked.orders, asked.times, asked.marks, asked.part)
    done = {} if asked.again else read_done()
    head = ["git", "rev-parse", "--short", "HEAD"]
    commit = subprocess.check_output(head, cwd=ROOT, encoding="utf-8")
    print(f"20 million additions: {reference_s():.2f} s of processor time", flush=True)
    lock = threading.Lock()

    def take(piece: Piece) -> None:
        outcome = run(piece, commit.strip())
        with lock:
            done[piece.name] = outcome
            write_done(done)
            how = "passed" if outcome.passed else "FAILED"
            print(f"{how} {piece.name}: {outcome.processor_s:.0f} s of processor time", flush=True)

    for phase in asked.phases:
        left = [
            piece
            for piece in wanted
            if piece.name.startswith(phase) and not (piece.name in done and done[piece.name].passed)
        ]
        programs = asked.programs if phase == "busy" and left else 0
        workers = ThreadPoolExecutor(asked.jobs)
        try:
            with busy_programs(programs):
                list(workers.map(take, left))
        finally:
            workers.shutdown(wait=False, cancel_futures=True)
            for group in tuple(RUNNING):
                os.killpg(group, signal.SIGKILL)
    print(table(wanted, done))
    return 0 if all(piece.name in done and done[piece.name].passed for piece in wanted) else 1


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends it as Ctrl-C does
    sys.exit(main())
