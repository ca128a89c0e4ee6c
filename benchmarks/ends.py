"""Ends runs at random: recordings that are cut, disks that are full, signals.

What is left is whole and says so.

cut: a recording of a run at random bytes. disk: a small tmpfs under the run (needs root). power:
    the disk under the run
loses power, and with it what the system had not given to it yet (needs root). orders: no end but
all beginnings, the processes of a run in lockstep started by hand in each order, at random moments.
Others: SIGTERM, SIGHUP and Ctrl-C at random moments of a command.

    saltus bench ends -- --what cut --times 2000
    saltus bench ends -- --what train --times 50 --out runs/ends.jsonl
"""

import contextlib
import hashlib
import itertools
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from mcap.reader import make_reader
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk

from benchmarks._command import Command, progress, tell
from benchmarks._judgement import is_upright
from benchmarks._kills import witness
from benchmarks._measuring import SIGNALS, hear_signals
from saltus.config import RunConfig, TerrainConfig
from saltus.errors import SaltusError
from saltus.heightmap.data.inventory import validate_dataset
from saltus.heightmap.data.shards import MANIFEST
from saltus.named_setup import named_setup
from saltus.policy.training.checkpoint import read_policy_checkpoint
from saltus.recordings.recorder import FLUSH_S, RECORDING_FILE, SYNC_S
from saltus.recordings.recording import read_recording
from saltus.recordings.repair import repair_recording
from saltus.runtime.programs import PROGRAMS
from saltus.runtime.run_folder import write_run
from saltus.runtime.stack import Stack
from saltus.wire.messages import ControllerMode, RobotState
from saltus.wire.router import open_router
from saltus.wire.zenoh_bus import ZenohBus

COURSE = ("--terrain", "flat", "--planner", "scripted", "--camera", "ideal")
COMMANDS: dict[str, tuple[str, ...]] = {
    "up": ("up", *COURSE),
    "demo": ("demo", *COURSE, "--no-video"),
    "train": ("policy", "train", "--device", "cpu", "--minutes", "10"),
    "collect": (
        "heightmap",
        "collect",
        "cpu",
        "--batches",
        "2000",
        "--loop.robots",
        "2",
        "--loop.courses",
        "2",
        "--processes",
        "1",
    ),
    "evaluate": ("policy", "eval", "--terrain", "flat", "--trials", "50", "--processes", "1"),
}
ENDED_S = 120.0
DISK_BYTES = 32_000_000  # several times a run's recording, and copied in an instant
# What is promised, and the step in which the supervisor writes
POWER_LOSS_S = FLUSH_S + SYNC_S + 0.1
ORDERS = list(itertools.permutations(PROGRAMS))
LIMIT_S = 3.0  # of a run that is started in some order
SETTLED_S = 0.3  # for its last messages


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    what: Literal[
        "cut", "disk", "power", "orders", "up", "demo", "train", "collect", "evaluate"
    ] = "cut"
    """The case: what is ended, and how."""
    times: int = 50
    """How often."""
    seed: int = 0
    within_s: float = 25.0
    """Signals come up to so long after the start of a command."""
    speed: float = 0.5
    """Speed of the clock of a run on a full disk."""
    out: Path | None = None
    """File of results so far, to go on from; by default none is kept."""

    def measure(self) -> dict[str, Any]:
        if self.what == "cut":
            return {"cut": self._cut()}
        rows = []
        if self.out is not None and self.out.is_file():
            lines = [json.loads(line) for line in self.out.read_text(encoding="utf-8").splitlines()]
            rows = [row for row in lines if row["what"] == self.what and row["number"] < self.times]
        try_one = {"disk": self._disk, "power": self._power, "orders": self._order}.get(
            self.what, self._signal
        )
        for number in progress(range(len(rows), self.times), self.what):
            rng = np.random.default_rng([self.seed, number])
            with tempfile.TemporaryDirectory() as folder:
                row = try_one(Path(folder), rng, number)
            if rows and row.get("states") != rows[0].get("states"):
                row["wrong"] += "it sent other states than in the first order; "
            rows.append({"what": self.what, "number": number, **row})
            if self.out is not None:
                with self.out.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(rows[-1]) + "\n")
            if row["wrong"]:
                tell(str(rows[-1]))
        return {
            self.what: {
                "times": len(rows),
                "with_files": sum(bool(row.get("files", True)) for row in rows),
                "wrong": [row["wrong"] for row in rows if row["wrong"]],
                "tracebacks": [row["traceback"] for row in rows if row.get("traceback")],
                **{
                    f"{name}_max": max(row.get(name, 0.0) for row in rows)
                    for name in ("ended_s", "ready_s", "lost_s")
                    if any(name in row for row in rows)
                },
            }
        }

    def _cut(self) -> dict[str, Any]:
        rng = np.random.default_rng(self.seed)
        config = RunConfig(
            robot="go1",
            grid="line",
            terrain=TerrainConfig(terrain="flat"),
            planner="scripted",
            time_limit_s=3.0,
        )
        with tempfile.TemporaryDirectory() as directory:
            folder = Path(directory)
            whole, cut, out = folder / RECORDING_FILE, folder / "cut.mcap", folder / "out.mcap"
            with Stack(config, folder) as stack:
                stack.wait()
            data, full, ends = whole.read_bytes(), in_order(whole), chunk_ends(whole)
            kept, wrong = [], 0
            for byte in progress(rng.integers(100, len(data), self.times).tolist(), "cut"):
                cut.write_bytes(data[:byte])
                repair_recording(cut, out)
                found = in_order(out)
                expected = max((count for end, count in ends if end <= byte), default=0)
                wrong += found != full[: len(found)] or len(found) < expected
                kept.append(len(found) - expected)
                out.unlink()
        return {"bytes": len(data), "messages": len(full), "cuts": self.times, "wrong": wrong,
                "saved_of_a_torn_chunk_mean": float(np.mean(kept))}  # fmt: skip

    def _order(self, folder: Path, rng: np.random.Generator, number: int) -> dict[str, Any]:
        """A run whose processes are started one after the other,
        each up to a second after the one before.
        """
        order = ORDERS[number % len(ORDERS)]
        config = RunConfig(
            robot="go1",
            grid="line",
            terrain=TerrainConfig(terrain="flat"),
            time_limit_s=LIMIT_S,
            epoch_ns=time.monotonic_ns(),
        )
        write_run(folder, config, named_setup(config))
        endpoint, router = open_router()
        processes: dict[str, subprocess.Popen[bytes]] = {}
        with contextlib.closing(router), ZenohBus(endpoint, config.prefix) as bus:
            heard, states, last = bus.stream(), hashlib.sha256(), b""
            waiting = {program.name: bus.latest("status", program.name) for program in order}
            for program in order:
                time.sleep(float(rng.uniform(0.0, 1.0)))
                processes[program.name] = subprocess.Popen(
                    [
                        sys.executable,
                        "-P",
                        "-m",
                        program.module,
                        "--run-dir",
                        str(folder),
                        "--endpoint",
                        endpoint,
                    ],
                    stdout=subprocess.DEVNULL,
                )
            started_s = ready_s = time.monotonic()
            goes_on = True
            while goes_on:  # once more after the end, for what was sent last
                goes_on = (
                    processes["controller"].poll() is None
                    and time.monotonic() - started_s < ENDED_S
                )
                time.sleep(0.01 if goes_on else SETTLED_S)
                if waiting:
                    waiting = {
                        name: latest for name, latest in waiting.items() if latest.take() is None
                    }
                    ready_s = time.monotonic()
                for sample in heard.drain():
                    if (
                        sample.key == "controller/state" and sample.payload != last
                    ):  # it asks again who is late
                        last = sample.payload
                        states.update(last)
            for process in processes.values():
                process.terminate()
            codes = {name: process.wait() for name, process in processes.items()}
        wrong = "".join(f"{name} never came; " for name in waiting) + "".join(
            f"{name} ended with {code}; " for name, code in codes.items() if code
        )
        names = [program.name for program in order]
        return {
            "order": names,
            "ready_s": ready_s - started_s,
            "states": states.hexdigest(),
            "wrong": wrong,
        }

    def _disk(self, folder: Path, rng: np.random.Generator, _number: int) -> dict[str, Any]:
        """A run on a file system with room for a random part of it."""
        room = int(rng.integers(200_000, 1_500_000))
        run = folder / "disk"
        with mounted(run, "-t", "tmpfs", "-o", f"size={room}", "tmpfs"):  # of so many bytes
            process = start(("up", *COURSE, "--speed", str(self.speed), "--out", str(run)))
            seen = witness(process, run, folder / "seen.mcap", float("inf"), lambda: None)
            _, told = process.communicate()
            states = seen.of(RobotState)
            kept = read_recording(run / "recording.mcap").of(RobotState)
        wrong = "".join(
            f"{name}; "
            for name, good in (
                ("exit code 0", process.returncode != 0),
                (
                    f"it said {told!r}",
                    "No space left" in told.splitlines()[-1] and "Traceback" not in told,
                ),
                (
                    "it fell",
                    states[-1].mode in (ControllerMode.STAND, ControllerMode.STOPPED)
                    and is_upright(seen, 5),
                ),
                ("nothing was kept", len(kept) > 0),
            )
            if not good
        )
        return {"room": room, "states_kept": len(kept), "wrong": wrong}

    def _power(self, folder: Path, rng: np.random.Generator, _number: int) -> dict[str, Any]:
        """A run whose disk is copied at a random moment:
        the copy is what a disk without power would hold.
        """
        disk, copy, place = folder / "disk.img", folder / "copy.img", folder / "mounted"
        run, after_s = place / "run", float(rng.uniform(0.5, 4.0))
        disk.touch()
        os.truncate(disk, DISK_BYTES)
        subprocess.run(["/sbin/mkfs.ext4", "-q", "-F", str(disk)], check=True)
        with mounted(place, "-o", "loop", str(disk)):
            process = start(("up", *COURSE, "--speed", str(self.speed), "--out", str(run)))

            def cut() -> None:
                shutil.copyfile(disk, copy)
                process.terminate()

            states = witness(process, run, folder / "seen.mcap", after_s, cut).of(RobotState)
            process.communicate()
        begun_ns = next(state.time_ns for state in states if state.mode == ControllerMode.RUN)
        wrong, kept_ns = "", 0
        with mounted(place, "-o", "loop", str(copy)):
            try:
                kept_ns = max(
                    state.time_ns for state in read_recording(run / RECORDING_FILE).of(RobotState)
                )
            except (SaltusError, ValueError) as error:
                wrong = f"{error}; "
        lost_s = (1e-9 * (begun_ns - kept_ns) + after_s) / self.speed
        wrong += f"{lost_s:.2f} s lost" if lost_s > POWER_LOSS_S else ""
        return {"after_s": after_s, "lost_s": lost_s, "wrong": wrong}

    def _signal(self, folder: Path, rng: np.random.Generator, _number: int) -> dict[str, Any]:
        """A command that is ended by a signal, and what it left."""
        sent = SIGNALS[rng.integers(len(SIGNALS))]
        after_s = float(rng.uniform(0.0, self.within_s))
        out = folder / "out"
        process = start((*COMMANDS[self.what], "--out", str(out)))
        try:
            process.wait(after_s)
        except subprocess.TimeoutExpired:
            process.send_signal(sent)
        begun_s = time.monotonic()
        try:
            _, told = process.communicate(timeout=ENDED_S)
        except subprocess.TimeoutExpired:
            process.kill()
            return {
                "signal": sent.name,
                "after_s": after_s,
                "wrong": f"it did not end within {ENDED_S:g} s",
            }
        wrong = "; ".join(leftovers(out))
        return {
            "signal": sent.name, "after_s": after_s, "exit_code": process.returncode,
            "ended_s": time.monotonic() - begun_s,
            "files": sorted(path.name for path in out.rglob("*.*")),
            "wrong": wrong, "said": told.splitlines()[-1:],
            "traceback": told.splitlines()[-1] if "Traceback" in told else "",
        }  # fmt: skip


def start(arguments: tuple[str, ...]) -> "subprocess.Popen[str]":
    """A command of Saltus in a process of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "saltus.cli.main", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=hear_signals,
        encoding="utf-8",
    )


def leftovers(out: Path) -> Iterator[str]:
    """Faults of the files that a command has left: not whole, or not finished."""
    checks: dict[str, Callable[[Path], object]] = {
        "*.mcap": in_order,
        "checkpoint.pt": read_policy_checkpoint,
        "*.json": lambda path: json.loads(path.read_text(encoding="utf-8")),
    }
    for pattern, check in checks.items():
        for path in out.rglob(pattern):
            try:
                check(path)
            except Exception as error:  # other readers raise anything
                yield f"{path.name}: {type(error).__name__}: {error}"
    for path in out.rglob("*"):
        if path.name.startswith(".") or path.suffix in (".part", ".partial"):
            yield f"{path.name} is left"
    for manifest in out.rglob(MANIFEST):
        try:
            yield from validate_dataset(manifest.parent)
        except SaltusError as error:
            yield str(error)


@contextmanager
def mounted(place: Path, *what: str) -> Iterator[None]:
    """A file system in a folder; needs root."""
    place.mkdir(exist_ok=True)
    done = subprocess.run(
        ["/bin/mount", *what, str(place)],
        capture_output=True,
        text=True,
        check=False,
        encoding="utf-8",
    )
    if done.returncode:
        raise SaltusError(f"no disk could be mounted (are you root?): {done.stderr.strip()}")
    try:
        yield
    finally:
        subprocess.run(["/bin/umount", "--lazy", str(place)], check=True)


def in_order(path: Path) -> list[tuple[str, int, bytes]]:
    """All messages of a file in its order, as plain `mcap` reads them."""
    with path.open("rb") as file:
        return [
            (c.topic, m.sequence, m.data)
            for _, c, m in make_reader(file).iter_messages(log_time_order=False)
        ]


def chunk_ends(path: Path) -> list[tuple[int, int]]:
    """Ends of the chunks of a whole file [bytes],
    and how many messages the file has up to there.
    """
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
        ends: list[tuple[int, int]] = []
        for index in summary.chunk_indexes if summary is not None else ():
            file.seek(index.chunk_start_offset)
            chunk = next(StreamReader(file, skip_magic=True, emit_chunks=True).records)
            assert isinstance(chunk, Chunk)
            count = sum(isinstance(record, Message) for record in breakup_chunk(chunk))
            before = ends[-1][1] if ends else 0
            ends.append((index.chunk_start_offset + index.chunk_length, before + count))
    return ends
