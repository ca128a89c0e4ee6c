"""Cost of a run's being watched: ages of its messages with
and without a page that somebody looks at.

saltus bench watch -- --runs 3 --speed 0.5
"""

import multiprocessing
import os
import re
import subprocess
import sys
import tempfile
import time
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import viser
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from benchmarks._command import Command, progress, tell
from saltus.config import RunConfig, TerrainConfig
from saltus.recordings.recording import read_recording
from saltus.recordings.timing import rates_and_ages
from saltus.runtime.stack import Stack

CAMERA = {
    "type": "ViewerCameraMessage", "wxyz": (1.0, 0.0, 0.0, 0.0), "position": (0.0, -2.0, 0.5),
    "fov": 1.0, "near": 0.1,
    "far": 100.0, "image_height": 600, "image_width": 800, "look_at": (0.0, 0.0, 0.0),
    "up_direction": (0.0, 0.0, 1.0),
}  # fmt: skip
"""By which a page says that it is there."""
SETTLED_S = 2.0  # of the machine; what a page is sent at first is more


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    runs: int = 3
    """With a page, and as many without, in turns."""
    speed: float = 0.5
    """Speed in parts of real time."""
    terrain: str = "flat"
    """Terrain that the robot crosses."""

    def measure(self) -> dict[str, Any]:
        """Ages, and by what factor they are longer in a run
        that is watched than in the one next to it.
        """
        ages: dict[bool, list[dict[str, tuple[float, float]]]] = {False: [], True: []}
        rates, shares = [], []
        for number in progress(range(2 * self.runs)):
            watched = (number + number // 2) % 2 == 1  # alone, watched, watched, alone
            with tempfile.TemporaryDirectory() as folder:
                figures = self._run(Path(folder) / "run", watched=watched)
                timing = rates_and_ages(read_recording(Path(folder) / "run" / "recording.mcap"))
            if watched:
                rates.append(figures["messages_hz"])
                shares.append(figures["processor"])
            ages[watched].append(
                {name: (row.age_p50_ms, row.age_p99_ms) for name, row in timing.items()}
            )
            heights = ages[watched][-1]["heightmap/heightmap"][1]
            tell(f"{'watched' if watched else 'alone'}: heights are {heights:.2f} ms old (p99)")
        return {
            "messages_hz": rates, "processor": shares, "load": os.getloadavg()[0],
            "ages": {name: _compared(ages, name) for name in ages[False][0] if name != "status"},
        }  # fmt: skip

    def _run(self, run_dir: Path, *, watched: bool) -> dict[str, float]:
        """One run.

        Of the page the messages that its reader receives and the share of a processor that it
        takes.
        """
        config = RunConfig(
            robot="go1",
            grid="line",
            terrain=TerrainConfig(terrain=self.terrain),
            pace="realtime",
            speed=self.speed,
            camera="d435i",
        )
        page_of_run = WatchedPage(run_dir) if watched else nullcontext()
        with page_of_run as page, Stack(config, run_dir) as stack:
            if page is not None:
                page.begin()
            stack.wait()
            return {} if page is None else page.end()


def _compared(
    ages: dict[bool, list[dict[str, tuple[float, float]]]], topic: str
) -> dict[str, float]:
    """Medians of a topic's ages, and quartiles of the ratios of pairs:
    a computer's speed changes from hour to hour.
    """
    alone, watched = (np.array([row[topic] for row in ages[which]]) for which in (False, True))
    low, ratio, high = np.quantile(watched[:, 1] / alone[:, 1], [0.25, 0.5, 0.75])
    return {
        "p50_alone_ms": float(np.median(alone[:, 0])),
        "p50_watched_ms": float(np.median(watched[:, 0])),
        "p99_alone_ms": float(np.median(alone[:, 1])),
        "p99_watched_ms": float(np.median(watched[:, 1])),
        "p99_ratio": float(ratio), "p99_ratio_quarter": float(low),
        "p99_ratio_three_quarters": float(high),
    }  # fmt: skip


class WatchedPage:
    """`saltus watch` and a reader that draws nothing, each in a process of its own."""

    def __init__(self, run_dir: Path) -> None:
        command = [
            sys.executable,
            "-P",
            "-m",
            "saltus.cli.main",
            "watch",
            str(run_dir),
            "--port",
            "0",
        ]
        self._server = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            text=True,
            encoding="utf-8",
        )
        assert self._server.stdout is not None
        found = re.search(r"http://\S+", self._server.stdout.readline())
        assert found is not None
        spawn = multiprocessing.get_context("spawn")
        self._count = spawn.Value("q", 0)
        self._reader = spawn.Process(target=read, args=(found[0], self._count), daemon=True)
        self._reader.start()
        self._begun = (0.0, 0, 0.0)

    def __enter__(self) -> "WatchedPage":
        while self._count.value == 0:
            time.sleep(0.05)
        return self

    def __exit__(self, *_: object) -> None:
        self._reader.terminate()
        self._server.terminate()
        self._server.wait()

    def begin(self) -> None:
        """Counts from now on."""
        time.sleep(SETTLED_S)
        self._begun = (time.monotonic(), self._count.value, self._processor_s())

    def end(self) -> dict[str, float]:
        """Messages since then."""
        seconds = time.monotonic() - self._begun[0]
        return {
            "messages_hz": (self._count.value - self._begun[1]) / seconds,
            "processor": (self._processor_s() - self._begun[2]) / seconds,
        }

    def _processor_s(self) -> float:
        fields = (
            Path(f"/proc/{self._server.pid}/stat")
            .read_text(encoding="utf-8")
            .rpartition(")")[2]
            .split()
        )
        # proc(5): utime and stime
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def read(address: str, count: Any) -> None:
    """Receives what the page is sent and counts the messages."""
    version = Subprotocol(f"viser-v{viser.__version__}")
    with connect(
        address.replace("http", "ws", 1).rstrip("/"), subprotocols=[version], max_size=None
    ) as link:
        link.send(msgspec.msgpack.encode(CAMERA))
        try:
            while True:
                link.recv()
                count.value += 1
        except ConnectionClosed:
            return
