"""Where processes of a run spend processor time: calls of some functions are timed while they run.

Time is that of the main thread, without what timed functions that a function calls took. Other
threads are Zenoh's: their time counts as Zenoh's part. What is left over is Python around it all.
"""

import atexit
import functools
import importlib
import json
import os
import runpy
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from saltus.runtime.programs import Program

PARTS = {
    "law": ("saltus.controller.tick:CompiledTickLaw.act",),
    "estimator": ("saltus.controller.tick:CompiledTickLaw.sense",),
    "tick": (
        "saltus.controller.control_loop:ControlLoop.sense",
        "saltus.controller.control_loop:ControlLoop.act",
    ),
    "plant": ("saltus.sim.driven_robots:DrivenRobots.step",),
    "truth": ("saltus.controller.robot.mujoco:MujocoRobot.truth",),
    "camera": ("saltus.render.process:CameraProcess.step",),
    "network": ("saltus.heightmap.service.network:HeightmapNetwork.tick",),
    "service": ("saltus.heightmap.service.fleet:FleetService.step",),
    "planner": ("saltus.policy.process:PlannerProcess.step",),
    "codec": ("saltus.wire.codec:encode_message", "saltus.wire.codec:decode_message"),
    "recorder": (
        "saltus.recordings.recorder:Recorder.write",
        "saltus.recordings.recorder:Recorder.flush",
    ),
    "zenoh": ("saltus.wire.zenoh_bus:ZenohPublisher.put",),
    "waiting": ("saltus.runtime.ticker:Ticker.wait", "saltus.wire.bus:Bell.wait"),
}
"""Functions of each part, as module:name; `waiting` is what it takes to fall asleep and to wake
up, `tick` what a tick of the control loop takes beside its laws."""
_FOLDER = "SALTUS_PARTS"
"""Variable that tells the processes where to leave their figures."""


@dataclass(frozen=True)
class Spent:
    """Processor time [s] of a process, from when it was ready to its end, by part;
    `total` is all of it.
    """

    parts: dict[str, float]
    calls: dict[str, int]
    total: float
    ticks_us: list[list[float]]
    """Each tick of the control loop [us], whole and beside its laws; none in other processes."""


class Meter:
    """Times the functions of `PARTS` in the main thread of this process,
    those that it has loaded, from now on.
    """

    def __init__(self) -> None:
        self._spent: Counter[str] = Counter()
        self._calls: Counter[str] = Counter()
        self._inner: list[int] = []
        self._halves_ns: list[tuple[int, int]] = []  # of ticks: sense and act in turn
        self._undo: list[Callable[[], None]] = []
        self._from_s, self._threads_from_s = time.process_time(), _other_threads_s()
        for part, names in PARTS.items():
            for name in names:
                if name.partition(":")[0] in sys.modules:
                    self._wrap(part, name)

    def end(self) -> Spent:
        """Stops timing, and returns what was spent."""
        for undo in self._undo:
            undo()
        total = time.process_time() - self._from_s
        parts = {part: 1e-9 * spent for part, spent in self._spent.items()}
        parts["zenoh"] = parts.get("zenoh", 0.0) + _other_threads_s() - self._threads_from_s
        parts["rest"] = total - sum(parts.values())
        halves = zip(self._halves_ns[::2], self._halves_ns[1::2], strict=False)
        ticks = [[1e-3 * (a + b) for a, b in zip(*half, strict=True)] for half in halves]
        return Spent(parts, dict(self._calls), total, ticks)

    def _wrap(self, part: str, name: str) -> None:
        module, _, path = name.partition(":")
        *owners, attribute = path.split(".")
        owner = functools.reduce(getattr, owners, importlib.import_module(module))
        function = getattr(owner, attribute)
        spent, calls, inner, clock = self._spent, self._calls, self._inner, time.thread_time_ns

        @functools.wraps(function)
        def timed(*arguments: Any, **named: Any) -> Any:
            inner.append(0)
            start = clock()
            try:
                return function(*arguments, **named)
            finally:
                took = clock() - start
                own = took - inner.pop()
                spent[part] += own
                calls[part] += 1
                if part == "tick":
                    self._halves_ns.append((took, own))
                if inner:
                    inner[-1] += took

        setattr(owner, attribute, timed)
        self._undo.append(lambda: setattr(owner, attribute, function))


def _other_threads_s() -> float:
    """Processor time of all threads but the one that asks."""
    return time.process_time() - time.thread_time()


@contextmanager
def metered(programs: tuple[Program, ...], folder: Path) -> Iterator[tuple[Program, ...]]:
    """The programs with timed functions; each leaves its figures in the folder when it ends."""
    for program in programs:
        text = (
            f"from benchmarks._parts import run_timed\n\nrun_timed({program.name!r}, "
            f"{program.module!r})\n"
        )
        (folder / f"timed_{program.name}.py").write_text(text, encoding="utf-8")
    paths = (
        str(folder),
        str(Path(__file__).resolve().parents[1]),
        os.environ.get("PYTHONPATH", ""),
    )
    before = dict(os.environ)
    os.environ |= {"PYTHONPATH": os.pathsep.join(filter(None, paths)), _FOLDER: str(folder)}
    try:
        yield tuple(replace(program, module=f"timed_{program.name}") for program in programs)
    finally:
        os.environ.clear()
        os.environ.update(before)


def run_timed(name: str, module: str) -> None:
    """Runs the module of a process, and writes what it spent from when it began to its end."""
    from saltus.runtime.process import ProcessContext

    ready = ProcessContext.ready

    def begun(context: ProcessContext) -> None:
        ready(context)
        atexit.register(_leave, name, Meter())

    ProcessContext.ready = begun  # type: ignore[method-assign,assignment]
    runpy.run_module(module, run_name="__main__", alter_sys=True)


def _leave(name: str, meter: Meter) -> None:
    (Path(os.environ[_FOLDER]) / f"{name}.json").write_text(
        json.dumps(vars(meter.end())), encoding="utf-8"
    )


def spent_by(programs: tuple[Program, ...], folder: Path) -> dict[str, Spent]:
    """Figures that the processes have left; those of one that was killed are missing."""
    files = {program.name: folder / f"{program.name}.json" for program in programs}
    return {
        name: Spent(**json.loads(file.read_text(encoding="utf-8")))
        for name, file in files.items()
        if file.is_file()
    }
