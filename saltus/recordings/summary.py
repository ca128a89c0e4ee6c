"""Numbers that sum up a recorded run."""

import json
from collections import Counter
from dataclasses import dataclass

import numpy as np

from saltus.effects.motors import VoltageSag
from saltus.errors import RecordingError
from saltus.recordings.recording import Recording
from saltus.recordings.timing import rates_and_ages, run_digest
from saltus.robots.robot import JOINTS
from saltus.wire.messages import (
    ControllerMode,
    Event,
    GroundTruth,
    Heightmap,
    HeightmapStatus,
    JointLog,
    ProcessStatus,
    RobotState,
)


@dataclass(frozen=True, kw_only=True)
class MotionPower:
    """Power of a robot's joints while the controller was in one mode: torque, as the drives
    believe, times speed.
    """

    motion: str
    """Name of the mode, in small letters."""
    seconds: float
    """Time for which the robot was in this motion."""
    peak_w: float
    """Greatest power of all joints together."""
    driving_w: float
    """Mean of that power where it is positive, as if none came back from joints that brake."""
    joint: str
    """Joint with the greatest power of its own."""
    joint_w: float
    """Greatest power of that joint."""
    voltage_left: float = 1.0
    """Least share of the battery's voltage, by the effect `voltage_sag` of the run's profile."""


def motion_powers(recording: Recording) -> tuple[MotionPower, ...]:
    """Power of each motion, in the order in which they began;
    none where no joints were recorded.
    """
    modes = {state.step: state.mode for state in recording.of(RobotState)}
    rows: dict[ControllerMode, list[JointLog]] = {}
    for log in recording.of(JointLog):
        if log.step in modes and len(log.velocity):
            rows.setdefault(ControllerMode(modes[log.step]), []).append(log)
    sag = _sag(recording) if rows else VoltageSag()
    return tuple(_power(mode, logs, sag) for mode, logs in rows.items())


def _sag(recording: Recording) -> VoltageSag:
    effects = recording.setup.profile.actuator
    return next((each for each in effects if isinstance(each, VoltageSag)), VoltageSag())


def _power(mode: ControllerMode, logs: list[JointLog], sag: VoltageSag) -> MotionPower:
    each = np.concatenate([log.torque_estimated * log.velocity for log in logs])
    total = each.sum(axis=1)
    joint = int(np.argmax(each.max(axis=0)))
    return MotionPower(
        motion=mode.name.lower(), seconds=sum(log.dt_s * len(log.velocity) for log in logs),
        peak_w=float(total.max()), driving_w=float(total.clip(min=0.0).mean()),
        joint=JOINTS[joint], joint_w=float(each[:, joint].max()),
        voltage_left=float(sag.left(each.clip(min=0.0).sum(axis=1)).min()),
    )  # fmt: skip


OUTCOME_CODES = ("finished", "fell", "timeout")
STOPPED = "the robot stopped"
TROUBLE = {
    "too_slow": "",
    "process_died": "a process died",
    "depth_lost": "no images",
    "heightmap_lost": STOPPED,
    "heightmap_invalid": STOPPED,
    "plan_lost": STOPPED,
}
"""Events of a running robot that lead to its failure, and what a person calls them.

Some make it stop.
"""


@dataclass(frozen=True, kw_only=True)
class RunSummary:
    """Metrics of one run; times and speeds as `saltus.trial` defines them."""

    terrain: str
    success: bool
    cause: str
    """Why it failed; empty after success."""
    explanation: str
    """Explanation of a failure in sentences: its beginning, what followed, and last the cause.

    Empty after success.
    """
    distance_m: float
    timed: str
    """From where, in words, time and speed are measured."""
    time_s: float
    mean_speed_mps: float
    heightmap_mae_m: float
    """Mean absolute error over all points and all steps in which the robot ran on a heightmap of
    status OK."""
    digest: str
    """Empty where the recording lacks a message: in real time a busy machine may drop one."""
    lost: int
    """Messages that the recording lacks: the sum of `TopicTiming.lost`."""
    motions: tuple[MotionPower, ...]
    """Power of the joints in each motion."""
    models: dict[str, str]
    """Names of the networks: the first half of their files' sha256."""
    camera: str
    """Name and fingerprint of the camera."""
    rates_hz: dict[str, float]
    age_ms: dict[str, dict[str, float]]
    rejected: dict[str, int]


def number_text(value: float, digits: int, unit: str) -> str:
    """A number for a person; one that nothing was measured for is "unknown"."""
    return f"{value:.{digits}f} {unit}" if np.isfinite(value) else "unknown"


def number_cell(value: float, digits: int) -> str:
    """A number in a table; "-" where there is none."""
    return f"{value:.{digits}f}" if np.isfinite(value) else "-"


def summarise_run(recording: Recording) -> RunSummary:
    """Computes the summary of a run.

    A run that was cut off has no outcome and counts as a failure.
    """
    outcome = _outcome(recording)
    success, cause = (
        bool(outcome.get("success", False)),
        str(outcome.get("cause", "the run was cut off")),
    )
    timing = rates_and_ages(recording)
    return RunSummary(
        terrain=recording.terrain.kind if recording.config else "unknown",
        success=success,
        cause=cause,
        explanation=""
        if success
        else "; then ".join([*_troubles(recording), cause.replace("_", " ")]),
        distance_m=float(outcome["distance_m"]) if outcome else _way(recording),
        timed=recording.terrain.timed,
        time_s=float(outcome.get("time_s", np.nan)),
        mean_speed_mps=float(outcome.get("mean_speed_mps", np.nan)),
        heightmap_mae_m=heightmap_error(recording),
        digest=_digest(recording),
        lost=sum(row.lost for row in timing.values()),
        motions=motion_powers(recording),
        models=recording.models,
        camera=f"{recording.camera.name} {recording.camera.fingerprint}",
        rates_hz={topic: row.rate_hz for topic, row in timing.items()},
        age_ms={
            topic: {"p50": row.age_p50_ms, "p99": row.age_p99_ms} for topic, row in timing.items()
        },
        rejected=_rejected(recording),
    )


def run_sentence(summary: RunSummary) -> str:
    """How a run went, for people."""
    verdict = "crossed" if summary.success else f"did not cross ({summary.explanation})"
    way, error = (
        number_text(summary.distance_m, 2, "m"),
        number_text(100 * summary.heightmap_mae_m, 1, "cm"),
    )
    time = (
        f"{number_text(summary.time_s, 2, 's')} at "
        f"{number_text(summary.mean_speed_mps, 2, 'm/s')} {summary.timed}"
    )
    lost = f"; the recording lacks {summary.lost} messages" if summary.lost else ""
    return (
        f"{verdict} {summary.terrain}: {way} from the start; {time}; heightmap error {error}{lost}"
    )


def _way(recording: Recording) -> float:
    """How far along x the base came in a run without an end [m]."""
    x = [truth.position_base_in_world[0] for truth in recording.of(GroundTruth)]
    return float(max(x) - x[0]) if x else np.nan


def _digest(recording: Recording) -> str:
    try:
        return run_digest(recording)
    except RecordingError:
        return ""


UNDER_WAY = (ControllerMode.RUN, ControllerMode.WALK)
"""Modes in which a robot follows a planner."""


def heightmap_error(recording: Recording) -> float:
    """Mean absolute error of the predicted heights [m] while it runs
    or walks on a heightmap of status OK.
    """
    running = {state.step for state in recording.of(RobotState) if state.mode in UNDER_WAY}
    truth = {message.step: message.height for message in recording.of(GroundTruth)}
    errors = [
        np.abs(np.asarray(message.height) - truth[message.step])
        for message in recording.of(Heightmap)
        if message.status == HeightmapStatus.OK
        and message.step in running
        and message.step in truth
    ]
    return float(np.mean(errors)) if errors else float("nan")


def _troubles(recording: Recording) -> list[str]:
    """Troubles between a robot's first step and its end,
    the first of each kind, one phrase each, in order.
    """
    # A computer is too slow from the beginning; that takes seconds to tell.
    events = sorted(
        recording.of(Event), key=lambda event: (event.code != "too_slow", event.time_ns)
    )
    run_ns = min((event.time_ns for event in events if event.code == "mode_run"), default=np.inf)
    end_ns = min((event.time_ns for event in events if event.code in OUTCOME_CODES), default=np.inf)
    first: dict[str, str] = {}
    for event in events:
        if event.code == "too_slow" or (event.code in TROUBLE and run_ns < event.time_ns <= end_ns):
            first.setdefault(TROUBLE[event.code], event.detail)
    return [f"{kind}: {detail}" if kind else detail for kind, detail in first.items()]


def _outcome(recording: Recording) -> dict[str, str | float]:
    """The trial's outcome as the controller announced it."""
    for event in recording.of(Event):
        if event.code in OUTCOME_CODES:
            outcome: dict[str, str | float] = json.loads(event.detail)
            return outcome
    return {}


def _rejected(recording: Recording) -> dict[str, int]:
    """Rejected messages by "process: topic/reason", from the last status of every process."""
    last = {status.process: status.rejected for status in recording.of(ProcessStatus)}
    total: Counter[str] = Counter()
    for process, rejected in last.items():
        total.update({f"{process}: {key}": count for key, count in rejected.items()})
    return dict(total)
