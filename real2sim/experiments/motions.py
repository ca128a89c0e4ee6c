"""Motions that make effects visible: commands for the joints of a held robot,
and for the body of one that stands.

A motion is a value: everything about it is known before the robot moves, so that it can be checked
against limits. The joints of a held robot move about the pose in which it stands, near the middle
of the range of the calf.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from saltus.arrays import Floats
from saltus.constants import GRAVITY, PHYSICS_DT
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import Robot
from saltus.rotations import quaternion_from_roll_pitch_yaw, rotation_matrix

RAMP_S = 0.5
"""Motions begin and end at rest, over this time."""
JOINT_PHASE = np.tile([0.0, 2.0, 4.0], 4) + np.repeat([0.0, 0.5, 1.0, 1.5], 3)
"""Phase of each joint [rad]: joints of a leg do not move in step, so that coupling between them
shows."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ExperimentCommands:
    """Joint commands of an experiment at each tick, shapes (n, 12)."""

    q_des: Floats
    dq_des: Floats
    tau_ff: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class ExperimentSection:
    """A stretch of an experiment: it becomes a segment of the run log."""

    name: str
    condition: str
    """Sections of one condition are repeats."""
    commands: ExperimentCommands
    ahead_m: float | None = None
    """The robot is put anew before it, at rest, where the first edge of the terrain lies this far
    ahead of its base."""
    drop_m: float = 0.0
    """The height from which it is let fall then."""


def sweep(
    robot: Robot, duration_s: float, start_hz: float, end_hz: float, amplitude_rad: float
) -> ExperimentCommands:
    """Chirp about the stand, logarithmic in frequency.

    The amplitude of the velocity does not rise beyond 1 Hz.
    """
    t = _times(duration_s)
    rate = np.log(end_hz / start_hz) / duration_s
    phase = 2.0 * np.pi * start_hz * np.expm1(rate * t) / rate
    amplitude = (
        amplitude_rad * _envelope(t, duration_s) / np.maximum(1.0, start_hz * np.exp(rate * t))
    )
    return _about_stand(robot, amplitude[:, None] * np.sin(phase[:, None] + JOINT_PHASE))


def sine(
    robot: Robot, duration_s: float, frequency_hz: float, amplitude_rad: float
) -> ExperimentCommands:
    """One frequency, all joints."""
    t = _times(duration_s)
    wave = np.sin(2.0 * np.pi * frequency_hz * t[:, None] + JOINT_PHASE)
    return _about_stand(robot, amplitude_rad * _envelope(t, duration_s)[:, None] * wave)


def triangle(
    robot: Robot, duration_s: float, speed_rad_s: float, amplitude_rad: float
) -> ExperimentCommands:
    """Back and forth at one speed: each direction of motion,
    reversals, no acceleration in between.
    """
    t = _times(duration_s)
    quarter = amplitude_rad / speed_rad_s
    u = (t[:, None] + quarter * JOINT_PHASE * 2.0 / np.pi) / quarter
    wave = 1.0 - np.abs((u + 1.0) % 4.0 - 2.0)
    return _about_stand(robot, amplitude_rad * _envelope(t, duration_s)[:, None] * wave)


def steps(
    robot: Robot, duration_s: float, period_s: float, amplitude_rad: float | Sequence[float]
) -> ExperimentCommands:
    """Jumps of the desired angle from one side of the stand to the other,
    a joint of each leg at a time.
    """
    t = _times(duration_s)
    turn = np.tile([0.0, 1.0 / 3.0, 2.0 / 3.0], 4) * period_s
    sign = np.where(((t[:, None] + turn) // period_s) % 2 < 1, 1.0, -1.0)
    inside = ((t > RAMP_S) & (t < duration_s - RAMP_S))[:, None]
    offset = np.where(inside, np.tile(np.broadcast_to(amplitude_rad, 3), 4) * sign, 0.0)
    return ExperimentCommands(
        q_des=robot.stand_pose + offset, dq_des=np.zeros_like(offset), tau_ff=np.zeros_like(offset)
    )


def hold_ladder(
    robot: Robot, duration_s: float, amplitude_rad: float, rungs: int
) -> ExperimentCommands:
    """Rest at evenly spaced angles, up and down again:
    gravity, bias and breakaway without motion.
    """
    t = _times(duration_s)
    up = np.linspace(-1.0, 1.0, rungs)
    levels = np.concatenate([[0.0], up, up[-2::-1], [0.0]])
    edges = np.linspace(0.0, duration_s, len(levels) + 1)
    move_s = min(0.3, 0.3 * duration_s / len(levels))  # a third of a rung moves, the rest holds
    knots_t = np.concatenate(
        [[0.0], np.repeat(edges[1:-1], 2) + np.tile([0.0, move_s], len(levels) - 1), [duration_s]]
    )
    knots_y = np.repeat(levels, 2)
    wave = np.interp(t, knots_t, knots_y)
    direction = np.tile([1.0, -1.0, 1.0], 4)
    return _about_stand(robot, amplitude_rad * wave[:, None] * direction)


def torque_ladder(
    robot: Robot, duration_s: float, highest_nm: Sequence[float], rungs: int, pulse_s: float
) -> ExperimentCommands:
    """Short feed-forward pulses of rising size, pushing and pulling in turn,
    one joint of each leg at a time.

    The desired angle stays that of the stand: the PD law brings the joint back.
    """
    t = _times(duration_s)
    torque = np.zeros((len(t), len(robot.stand_pose)))
    pulses = rungs * 2 * 3
    period = (duration_s - 2.0 * RAMP_S) / pulses
    for pulse in range(pulses):
        rung, side, joint = pulse // 6, 1.0 - 2.0 * ((pulse // 3) % 2), pulse % 3
        begin = RAMP_S + pulse * period
        on = (t >= begin) & (t < begin + pulse_s)
        torque[np.ix_(on, np.arange(joint, 12, 3))] = side * highest_nm[joint] * (rung + 1) / rungs
    return ExperimentCommands(
        q_des=np.tile(robot.stand_pose, (len(t), 1)), dq_des=np.zeros_like(torque), tau_ff=torque
    )


def body_chirp(
    robot: Robot,
    duration_s: float,
    start_hz: float,
    end_hz: float,
    height_m: float = 0.0,
    pitch_rad: float = 0.0,
) -> ExperimentCommands:
    """Heave and pitch of a robot that stands, a quarter of a period apart.

    Speeds do not rise beyond 1 Hz.
    """
    t = _times(duration_s)
    rate = np.log(end_hz / start_hz) / duration_s
    phase = 2.0 * np.pi * start_hz * np.expm1(rate * t) / rate
    amplitude = _envelope(t, duration_s) / np.maximum(1.0, start_hz * np.exp(rate * t))
    return stance(
        robot, height_m * amplitude * np.sin(phase), pitch_rad * amplitude * np.cos(phase)
    )


def body_sine(
    robot: Robot,
    duration_s: float,
    frequency_hz: float,
    height_m: float = 0.0,
    pitch_rad: float = 0.0,
) -> ExperimentCommands:
    """Heave and pitch of a robot that stands, at one frequency."""
    t = _times(duration_s)
    phase, amplitude = 2.0 * np.pi * frequency_hz * t, _envelope(t, duration_s)
    return stance(
        robot, height_m * amplitude * np.sin(phase), pitch_rad * amplitude * np.sin(phase)
    )


def rest(robot: Robot, duration_s: float) -> ExperimentCommands:
    """A robot that stands still."""
    nothing = np.zeros(len(_times(duration_s)))
    return stance(robot, nothing, nothing)


def stance(robot: Robot, height_m: Floats, pitch_rad: Floats) -> ExperimentCommands:
    """Joint commands that move the body over feet which stay where they stand.

    Args:
        robot: Which one.
        height_m: Of the base, above that in its stand pose, shape (n,).
        pitch_rad: Of the base, nose down positive, shape (n,).

    Returns:
        Angles by inverse kinematics and the feed-forward torque that carries a quarter of the
        weight on each leg.
    """
    zero = np.zeros_like(height_m)
    # (n, 3, 3)
    rotation = np.asarray(rotation_matrix(quaternion_from_roll_pitch_yaw(zero, pitch_rad, zero)))
    legs = LegKinematics(robot)
    # (n, 4, 3), world
    raised = legs.position(robot.stand_pose) - np.stack([zero, zero, height_m], axis=-1)[:, None, :]
    q_des = legs.inverse(raised @ rotation)
    jacobian = legs.jacobian(q_des)
    # What a foot exerts, (n, 3)
    down_in_base = rotation.mT @ np.array([0.0, 0.0, -0.25 * robot.mass * GRAVITY])
    tau_ff = np.einsum("nlij,ni->nlj", jacobian, down_in_base).reshape(len(q_des), 12)
    return ExperimentCommands(
        q_des=q_des, dq_des=np.gradient(q_des, PHYSICS_DT, axis=0), tau_ff=tau_ff
    )


def repeat_motion(
    name: str, count: int, commands: ExperimentCommands
) -> tuple[ExperimentSection, ...]:
    """A motion several times over: repeats tell noise from what the simulator lacks."""
    return tuple(
        ExperimentSection(name=f"{name} {i + 1}", condition=name, commands=commands)
        for i in range(count)
    )


def _times(duration_s: float) -> Floats:
    return PHYSICS_DT * np.arange(round(duration_s / PHYSICS_DT), dtype=np.float64)


def _envelope(t: Floats, duration_s: float) -> Floats:
    """From 0 to 1 and back, smooth, shape of `t`."""
    edge = np.clip(np.minimum(t, duration_s - t) / RAMP_S, 0.0, 1.0)
    return edge**2 * (3.0 - 2.0 * edge)


def _about_stand(robot: Robot, offset: Floats) -> ExperimentCommands:
    q_des = robot.stand_pose + offset
    return ExperimentCommands(
        q_des=q_des, dq_des=np.gradient(q_des, PHYSICS_DT, axis=0), tau_ff=np.zeros_like(q_des)
    )
