"""Mechanical power of the joints of a recorded robot, motion by motion."""

from dataclasses import dataclass

import numpy as np

from saltus.effects.motors import VoltageSag
from saltus.recordings.recording import Recording
from saltus.robots.robot import JOINTS
from saltus.wire.messages import ControllerMode, JointLog, RobotState


@dataclass(frozen=True, kw_only=True)
class MotionPower:
    """Power while the controller was in one mode: torque, as the drives believe, times speed."""

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
