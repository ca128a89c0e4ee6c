"""Kills a process in the middle of a real-time run, and judges from the recording what the others did about it."""

import os
import re
import signal
import subprocess
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np

from saltus.clock import RunClock
from saltus.config import RunConfig
from saltus.constants import POLICY_DT
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
    Event,
    GroundTruth,
    Heightmap,
    HeightmapStatus,
    Message,
    MotionPlan,
    PlanStatus,
    RobotState,
)
from saltus.wire.topics import CAMERA_LATENCY_S, TOPICS, depth_topic
from saltus.wire.zenoh_bus import ZenohBus

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
STANDING_HEIGHT_M = 0.18
"""A base above this is on its feet: two thirds of the standing height."""
UPRIGHT_COSINE = 0.87  # 30 degrees
LANDED = (ControllerMode.STOPPED, ControllerMode.DAMP)
AGE_ROUNDING_NS = 1_000_000
"""Ages are told in whole milliseconds."""
FOLLOWING = (ControllerMode.RUN, ControllerMode.COAST)
PRODUCT = {"render": "camera/depth", "heightmap": "heightmap/heightmap", "policy": "policy/plan"}
"""Topic that falls silent when a process dies."""
CONSUMER = {"heightmap": "policy", "policy": "controller"}
"""Process whose event says so; without a camera each heightmap does."""
BLIND = (HeightmapStatus.INVALID, HeightmapStatus.WARMING)
"""Statuses of the service without a camera, and with one that has just begun."""


End = Literal["crossed", "goes on", "stands", "fell"]
"""End of a robot: it has arrived, is on its way, or has landed; or none of these."""


@dataclass(frozen=True, kw_only=True)
class FaultResult:
    """Consequences of a kill."""

    process: str
    running_s: float
    """How long the robot had been running when the process was killed."""
    told_ms: float
    """From the last arrival of the dead process's product to the first message of its consumer that says so, before the
    product comes again; infinite where none does, as where another process goes on in time. A
    product that the consumer alone still had counts (`heard_alone_ns`)."""
    reported_ms: float
    """The same to the supervisor's event that the process died."""
    silence_ms: float
    """The longest time without that product, from this arrival on.

    To the end where it does not come again.
    """
    end: End
    """How the robot is at the end of the recording."""
    stale: int
    """Messages of the whole run that stood on something older than may be used, see
    `stale_uses`."""
    back_s: float
    """From the death noticed to the process being ready again.

    Infinite where it did not come back.
    """


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
        StackError: it did not within `RUN_TIMEOUT_S`.
    """
    if not _until(stack, RUN_TIMEOUT_S, lambda: _mode(states) == ControllerMode.RUN):
        raise StackError(f"the robot did not begin to run within {RUN_TIMEOUT_S:g} s")


def judge(recording: Recording, process: str, after_s: float) -> FaultResult:
    """Reads from a recording of `kill_during_run` what happened after the last kill."""
    died_ns, ready_ns = _death_and_return(recording, process)
    product = [
        (arrival, e.boot_id, e.capture_ns) for arrival, e, _ in recording.payloads(PRODUCT[process])
    ]
    last_ns = last_before([(arrival, boot_id) for arrival, boot_id, _ in product], died_ns)
    end_ns = recording.of(RobotState)[-1].time_ns
    again_ns = next((arrival for arrival, _, _ in product if arrival > last_ns), end_ns)
    complaints = (
        (told, newest)
        for told, newest in _complaints(recording, process)
        if last_ns < told <= again_ns
    )
    told, newest_ns = next(complaints, (None, None))
    if newest_ns is not None:
        made_ns = max(
            (made for arrival, _, made in product if arrival <= last_ns), default=newest_ns
        )
        last_ns += heard_alone_ns(newest_ns - made_ns, TOPICS[PRODUCT[process]].rate_hz)
    later = [last_ns, *(arrival for arrival, _, _ in product if arrival > last_ns), end_ns]
    return FaultResult(
        process=process,
        running_s=after_s,
        told_ms=1e-6 * (told - last_ns) if told is not None else float("inf"),
        reported_ms=1e-6 * max(0, died_ns - last_ns),
        silence_ms=1e-6 * max(b - a for a, b in pairwise(later)),
        end=end_of(recording),
        stale=stale_uses(recording),
        back_s=1e-9 * (ready_ns - died_ns) if ready_ns is not None else float("inf"),
    )


def last_before(product: Sequence[tuple[int, bytes]], died_ns: int) -> int:
    """Arrival of the last message of the process that died, 0 without one.

    It may be dated after the death, which the supervisor can notice before it reads what came last.

    Args:
        product: Arrival [ns] and sender of each message, in order of arrival.
        died_ns: When the death was noticed.
    """
    dead = [boot_id for arrival, boot_id in product if arrival <= died_ns][-1:]
    return max((arrival for arrival, boot_id in product if [boot_id] == dead), default=0)


def heard_alone_ns(newer_ns: int, rate_hz: float) -> int:
    """How much later than the last recorded message a consumer had its last one [ns, whole periods].

    A process sends to its consumer and to the recorder one after the other; who comes first differs
    from run to run. If it is killed between the two, the recorder lacks a message that the consumer
    has.

    Args:
        newer_ns: By how much the newest message that the consumer had was made after the last that
            was recorded.
        rate_hz: Of the messages.
    """
    period_ns = round(1e9 / rate_hz)
    return max(0, (newer_ns + AGE_ROUNDING_NS) // period_ns) * period_ns


def stale_uses(recording: Recording) -> int:
    """How many messages of a run stood on something older than may be used.

    That are heightmaps that say to be good of an image, plans to go on of a good heightmap, and
    states in which the controller follows a plan. Times are those of the robot's states that they
    answer, not of arrivals.
    """
    image = depth_topic(recording.camera.latency_s or CAMERA_LATENCY_S)
    good = [heightmap for heightmap in recording.of(Heightmap) if heightmap.status not in BLIND]
    plans = [plan.time_ns for plan in recording.of(MotionPlan) if plan.status == PlanStatus.GO]
    # What is used now was made a step ago
    heights, step_s = (
        TOPICS["heightmap/heightmap"],
        POLICY_DT,
    )
    states = recording.of(RobotState)
    decided = decided_ns([state.time_ns for state in states])
    followed = [
        time_ns for time_ns, state in zip(decided, states, strict=True) if state.mode in FOLLOWING
    ]
    return (
        sum(heightmap.depth_age_s > image.invalid_age_s for heightmap in good)
        + late_uses(
            plans, [heightmap.time_ns for heightmap in good], heights.invalid_age_s + step_s
        )
        + late_uses(followed, plans, TOPICS["policy/plan"].invalid_age_s + step_s)
    )


def decided_ns(states_ns: Sequence[int]) -> list[int]:
    """When the controller decided the mode that a state tells: before it could have the plan that answers this state.

    That was in the step before, also where the controller itself was held up between the two.
    """
    step_ns = round(1e9 * POLICY_DT)
    befores = [*(first - step_ns for first in states_ns[:1]), *states_ns[:-1]]
    return [min(now - 1, before + step_ns) for before, now in zip(befores, states_ns, strict=True)]


def late_uses(uses_ns: Sequence[int], sources_ns: Sequence[int], limit_s: float) -> int:
    """How many uses have no source within the limit before them; times ascend."""
    uses, sources = np.asarray(uses_ns, np.int64), np.asarray([-(2**62), *sources_ns], np.int64)
    newest = sources[np.searchsorted(sources, uses, side="right") - 1]
    return int(np.sum(uses - newest > round(1e9 * limit_s)))


def end_of(recording: Recording) -> End:
    """End of the robot of a run: the controller judges a trial, and ends the run where the robot has fallen."""
    codes = {event.code for event in recording.of(Event)}
    if "finished" in codes:
        return "crossed"
    if recording.of(RobotState)[-1].mode in LANDED:
        return "stands" if is_upright(recording) else "fell"
    return "fell" if "fell" in codes else "goes on"


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
    return sample is not None and _says(sample.message, "process_ready", process)


def _says(event: Message, code: str, process: str) -> bool:
    """True where it is an event of the supervisor about this process."""
    return (
        isinstance(event, Event) and event.code == code and event.detail.startswith(f"{process}:")
    )


def _death_and_return(recording: Recording, process: str) -> tuple[int, int | None]:
    """Death and return of the process that died last."""
    died_ns = ready_ns = None
    for arrival, _, event in recording.messages("event/supervisor"):
        if _says(event, "process_died", process):
            died_ns, ready_ns = arrival, None
        elif _says(event, "process_ready", process) and ready_ns is None:
            ready_ns = arrival
    if died_ns is None:
        raise StackError(f"the recording does not show that {process} died")
    return died_ns, ready_ns


def _complaints(recording: Recording, process: str) -> Iterable[tuple[int, int | None]]:
    """The consumer's messages that the product is missing: arrival, and when the newest it had was made.

    The latter is None where the message names no age.
    """
    if process == "render":
        for arrival, _, heightmap in recording.messages("heightmap/heightmap"):
            if isinstance(heightmap, Heightmap) and heightmap.status in BLIND:
                yield arrival, _before(heightmap.time_ns, heightmap.depth_age_s)
        return
    for arrival, _, event in recording.messages(f"event/{CONSUMER[process]}"):
        if isinstance(event, Event) and event.code in (
            "heightmap_lost",
            "plan_lost",
            "mode_landing",
        ):
            yield arrival, _before(event.time_ns, _age_s(event.detail))


def _before(now_ns: int, age_s: float) -> int | None:
    return now_ns - round(1e9 * age_s) if np.isfinite(age_s) else None


def _age_s(words: str) -> float:
    """The age that a reason names: "no heightmap for 102 ms"."""
    named = re.search(r"(\d+) ms", words)
    return 1e-3 * int(named[1]) if named else float("inf")


def is_upright(recording: Recording, steps: int = 50) -> bool:
    """True where the robot stands, upright and at rest, in the last `steps` of 10 ms."""
    truths = recording.of(GroundTruth)[-steps:]
    _, x, y, _ = np.array([truth.quaternion_base_in_world for truth in truths]).T
    height = -np.array([truth.height for truth in truths])[:, 10]  # the point under the base
    speed = np.linalg.norm([truth.velocity_base_in_world for truth in truths], axis=1)
    cosine = 1 - 2 * (x * x + y * y)
    return bool(
        np.all(cosine > UPRIGHT_COSINE)
        and np.all(height > STANDING_HEIGHT_M)
        and np.median(speed) < 0.1
    )
