"""Kills a process in the middle of a real-time run,
and watches until the robot has landed or goes on.
"""

import os
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

from benchmarks._judgement import LANDED, says
from saltus.clock import RunClock
from saltus.config import RunConfig, TerrainConfig
from saltus.errors import StackError
from saltus.recordings.recorder import Recorder
from saltus.recordings.recording import Recording, read_recording
from saltus.runtime.programs import PROGRAMS, Program
from saltus.runtime.run_folder import CLIENT_FILE, endpoint_of, read_run
from saltus.runtime.stack import Stack
from saltus.wire.bus import Latest
from saltus.wire.messages import (
    SUPERVISOR,
    ControllerMode,
    RobotState,
)
from saltus.wire.zenoh_bus import ZenohBus

ON_FLAT_GROUND = RunConfig(
    robot="go1",
    grid="line",
    terrain=TerrainConfig(terrain="flat"),
    pace="realtime",
    planner="scripted",
)
"""A run in real time without a course to learn, for what is done to its processes."""
RUN_TIMEOUT_S = 20.0
BACK_S, LANDED_S = 2.0, 2.0
"""Waited for after the kill, at most: the process is ready again.

The robot has landed (1.1 s), or goes on.
"""
STANDING_S = (
    1.0  # watched after both: a process that is back tells a robot to go within a few steps
)
SILENT_S = 1.0  # a controller that is not heard for so long has gone
WAIT_S = 0.02  # for a message, at most


def kill_during_run(
    config: RunConfig,
    directory: Path,
    process: str,
    after_s: float,
    *,
    times: int = 1,
    watch_s: float = LANDED_S,
    programs: tuple[Program, ...] = PROGRAMS,
) -> Recording:
    """Starts a real-time run and kills a process `after_s` after the robot has begun to run.

    It goes on watching until the process is back, and the robot has landed and stood for a second,
    has arrived, or was watched for `watch_s`. All times are in the clock of the run.

    Args:
        config: Of the run.
        directory: Its folder.
        process: Which one.
        after_s: When.
        times: How often, each time as soon as it is back: the first ones are replaced by a standby,
            where it has one.
        watch_s: At most, after the last kill.
        programs: That make up the stack.

    Raises:
        StackError: the robot did not begin to run, or the run could not go on.
    """
    with Stack(config, directory, programs) as stack:
        states, events = stack.latest("controller/state"), stack.latest("event", SUPERVISOR)
        wait_until_running(stack, states)
        stack.wait(after_s)
        for _ in range(times):
            os.kill(stack.pid(process), signal.SIGKILL)
            _until(stack, BACK_S, lambda: _is_back(events, process))
        if _until(stack, watch_s, lambda: _mode(states) in LANDED):
            stack.wait(STANDING_S)
    return read_recording(directory / "recording.mcap")


def wait_until_running(stack: Stack, states: Latest) -> None:
    """Returns when the robot of a stack, whose `states` are given, has begun to run.

    Raises:
        StackError: it did not within `RUN_TIMEOUT_S`, or landed before it was seen to run.
    """
    seen: list[ControllerMode] = []

    def ended() -> bool:
        mode = _mode(states)
        seen.extend([] if mode is None else [mode])
        return mode in (ControllerMode.RUN, *LANDED)

    if not _until(stack, RUN_TIMEOUT_S, ended) or seen[-1] != ControllerMode.RUN:
        last = seen[-1].name if seen else "not heard"
        raise StackError(
            f"the robot did not begin to run within {RUN_TIMEOUT_S:g} s: it is {last}"
            + (", and the run is over" if stack.finished else "")
        )


def witness(
    supervisor: "subprocess.Popen[str]",
    run_dir: Path,
    path: Path,
    after_s: float,
    strike: Callable[[], None],
) -> Recording:
    """Records a run that another process hosts from beside it, until the controller has gone.

    So the end of a run can be judged whose own recording cannot be written, or whose supervisor was
    killed.

    Args:
        supervisor: The process that hosts the run.
        run_dir: Folder of the run.
        path: Of the recording that is made here.
        after_s: When `strike` is called [s of the run's clock], counted from when the robot began
            to run.
        strike: Does what the run should survive.

    Raises:
        StackError: the supervisor ended before the run began.
    """
    while not (run_dir / CLIENT_FILE).is_file():
        if supervisor.poll() is not None:
            raise StackError(
                f"the supervisor ended with {supervisor.returncode} before its run began"
            )
        time.sleep(0.02)
    run = read_run(run_dir)
    silent_s = RunClock.of(run.config).machine_s(SILENT_S)
    silent, begun_s = 0, None
    with (
        ZenohBus.of_run(
            endpoint_of(run_dir), run.config, peer=run.config.pace == "realtime"
        ) as bus,
        Recorder(path, run.config, run.setup) as recorder,
    ):
        stream, states = bus.stream(), bus.latest("controller/state")
        # silence is counted in waits: where the whole computer stands still, nobody has gone
        while supervisor.poll() is None or silent * WAIT_S < silent_s:
            recorder.write_all(stream)
            sample = states.wait(WAIT_S)
            silent += 1
            if sample is None or not isinstance(sample.message, RobotState):
                continue
            silent = 0
            time_s = 1e-9 * sample.message.time_ns
            if begun_s is None and sample.message.mode == ControllerMode.RUN:
                begun_s = time_s
            if begun_s is not None and time_s >= begun_s + after_s:
                after_s = float("inf")
                strike()
    return read_recording(path)


def _until(stack: Stack, timeout_s: float, seen: Callable[[], bool]) -> bool:
    """Polls until something is seen; False where the time or the run is over first."""
    period_s = 0.02 * stack.config.speed
    for _ in range(round(timeout_s / period_s)):
        if stack.wait(period_s):
            return False
        if seen():
            return True
    return False


def _mode(states: Latest) -> ControllerMode | None:
    sample = states.take()
    return (
        None
        if sample is None or not isinstance(sample.message, RobotState)
        else ControllerMode(sample.message.mode)
    )


def _is_back(events: Latest, process: str) -> bool:
    sample = events.take()
    return sample is not None and says(sample.message, "process_ready", process)
