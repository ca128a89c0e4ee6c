"""A soft motion of a robot that hangs, which shows what joints
hold against gravity and how late they answer.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from saltus.arrays import Floats
from saltus.controller.robot.unitree.listening import PreflightCheck, ticks_of
from saltus.controller.robot.unitree.messages import MOTORS, SERVO
from saltus.controller.robot.unitree.robot import UnitreeRobot
from saltus.controller.robot.unitree.states import LATE_S
from saltus.joint_command import JointCommand
from saltus.robots.robot import JOINTS, Robot
from saltus.sim.held_robot import HeldRobot

POSE = (0.0, 2.2, -2.2)
"""Hip, thigh, calf [rad]: knees behind, and shins down. Hips and thighs of a Go2 hold 1.1 and 0.7
Nm there, and a thigh that counts the other way cannot reach it: its stop is in the way."""
KP, KD = 40.0, 1.0
PULL_NM = 6.0
"""Torque that no gain exceeds, whatever is in the way: a tenth of what the knee could do."""
MOVE_S, PERIOD_S, PERIODS = 1.5, 1.0, 3
SWING_RAD = 0.1
"""Friction averages out over a motion that returns to where it began."""
PULSE_NM, PULSE_S = 1.0, 0.25
"""Square wave of torque at the hips: its edges show how late the drives answer."""
ANSWERS_S = 0.1  # within which an answer is looked for
HEAVY_NM = 0.5
"""Joints that hold less are judged by their range alone: friction of a calf is 1.1 Nm."""
OFF_NM = 1.5
"""Torques may differ from the model's weights by this: cables, friction that does not average."""
FOLLOWS_RAD = 0.15
"""Friction and weight, against KP, leave half of it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SoftMotion:
    """A motion as it was told and answered, n ticks of 2 ms."""

    time_s: Floats
    """By our clock, when each command was sent; shape (n,)."""
    told: Floats
    position: Floats
    torque: Floats
    """Target and measured angle [rad], torque in the drives' own belief [Nm], shape (n, 12)."""
    pulse: Floats
    """Feed-forward torque at the hips [Nm], shape (n,)."""
    on: bool
    """Every motor said throughout that it is on."""
    off: tuple[str, ...]
    """Joints whose motors said that they are not."""
    quaternion: Floats
    """Base in world, at the end, shape (4,)."""
    fault: str
    """Why the robot was damped; empty if it was not."""


def move_softly(robot: UnitreeRobot, kind: Robot, wait: Callable[[], float]) -> SoftMotion:
    """Brings the legs to `POSE`, swings them, and leaves them damped; `wait` as of `listen`.

    Raises:
        StackError: another program commands the robot. Nothing is sent then.
    """
    start = robot.read().measurement.joint_position
    goal = np.clip(np.tile(POSE, 4), kind.joint_lower, kind.joint_upper)
    rows: list[tuple[float, Floats, Floats, Floats, float]] = []
    off = np.zeros(MOTORS, np.bool_)
    quaternion = np.array([1.0, 0.0, 0.0, 0.0])
    for tick in range(ticks_of(MOVE_S + PERIODS * PERIOD_S)):
        now_s = wait()
        reading = robot.read()
        if robot.fault:
            break
        measured = reading.measurement
        quaternion = measured.quaternion_base_in_world
        target, pulse = _target(tick, start, goal)
        robot.write(_soft(target, measured.joint_position, pulse))
        if tick > ticks_of(ANSWERS_S):
            off |= robot.message["motor_state"]["mode"][:MOTORS] != SERVO
        rows.append((now_s, target, measured.joint_position, reading.joint_torque, pulse))
    times, told, position, torque, pulses = (np.array(column) for column in zip(*rows, strict=True))
    return SoftMotion(
        time_s=times, told=told, position=position, torque=torque, pulse=pulses,
        on=not off.any(), off=tuple(np.array(JOINTS)[off]), quaternion=quaternion,
        fault=robot.fault,
    )  # fmt: skip


def motion_checks(motion: SoftMotion, kind: Robot) -> list[PreflightCheck]:
    """Judges a motion, by the worst joint in each check.

    It was whole; the motors said that they were on; joints followed; torques held the weight, with
    its sign; hips answered in time. Of one that was cut short, the first two alone.
    """
    checks = [
        PreflightCheck(
            name="motion", passed=not motion.fault, found=motion.fault or "whole",
            allowed="no loss of states", cure="see the checks of the link",
        ),
        PreflightCheck(
            name="motors", passed=motion.on, found=", ".join(motion.off) or "all on",
            allowed="all on", cure="start the robot again; a motor that stays off is broken",
        ),
    ]  # fmt: skip
    swings = slice(ticks_of(MOVE_S), ticks_of(MOVE_S + PERIODS * PERIOD_S))
    if motion.fault or len(motion.time_s) < swings.stop:
        return checks
    position, held = motion.position[swings], motion.torque[swings].mean(axis=0)
    weight = HeldRobot(kind, JOINTS, motion.quaternion.tolist()).weight(position[::20]).mean(axis=0)
    return [
        *checks,
        _follows(motion.told[swings], position),
        _gravity(held, weight),
        _answers(motion),
    ]


def _target(tick: int, start: Floats, goal: Floats) -> tuple[Floats, float]:
    """Angles [rad] and torque of the hips [Nm] at a tick."""
    moved = tick / ticks_of(MOVE_S)
    if moved < 1.0:
        return start + (goal - start) * 0.5 * (1.0 - np.cos(np.pi * moved)), 0.0
    turned = (tick - ticks_of(MOVE_S)) / ticks_of(PERIOD_S)
    sign = -1.0 if (tick - ticks_of(MOVE_S)) // ticks_of(PULSE_S) % 2 else 1.0
    return goal + SWING_RAD * np.sin(2.0 * np.pi * turned), sign * PULSE_NM


def _soft(target: Floats, position: Floats, pulse: float) -> JointCommand:
    """A command that pulls with no more than `PULL_NM`."""
    near = position + np.clip(target - position, -PULL_NM / KP, PULL_NM / KP)
    torque = np.zeros((4, 3))
    torque[:, 0] = pulse
    one = np.ones(12)
    return JointCommand(
        position=near, velocity=0.0 * one, kp=KP * one, kd=KD * one, torque=torque.reshape(12)
    )


def _follows(told: Floats, position: Floats) -> PreflightCheck:
    off = np.abs((position - told).mean(axis=0))
    worst = int(np.argmax(off))
    return PreflightCheck(
        name="follows", passed=bool(off[worst] <= FOLLOWS_RAD),
        found=f"{JOINTS[worst]} {off[worst]:.2f} rad off its command",
        allowed=f"{FOLLOWS_RAD:g} rad", cure="what blocks it? A stop: its sign or zero is wrong",
    )  # fmt: skip


def _gravity(held: Floats, weight: Floats) -> PreflightCheck:
    """Torques against weights: a flipped sign holds the opposite."""
    heavy = np.abs(weight) >= HEAVY_NM
    wrong = np.where(heavy & (held * weight < 0.0), np.inf, np.abs(held - weight))
    worst = int(np.argmax(wrong))
    return PreflightCheck(
        name="gravity", passed=bool(wrong[worst] <= OFF_NM),
        found=f"{JOINTS[worst]} holds {held[worst]:+.1f} Nm of {weight[worst]:+.1f}",
        allowed=f"the same sign, within {OFF_NM:g} Nm",
        cure="its sign is wrong, it is the other side's, or it carries something",
    )  # fmt: skip


def _answers(motion: SoftMotion) -> PreflightCheck:
    """Time from an edge of the square wave to the first state that tells half of it,
    the usual of all edges.
    """
    hips = motion.torque[:, ::3].mean(axis=1)
    edges = np.flatnonzero(np.diff(motion.pulse)) + 1
    waits = [
        after
        for edge in edges[edges < len(hips) - ticks_of(ANSWERS_S)]
        if (after := _answer_s(motion, hips, int(edge))) is not None
    ]
    late_s = float(np.median(waits)) if len(waits) > len(edges) // 2 else np.inf
    return PreflightCheck(
        name="answers", passed=late_s <= LATE_S,
        found=f"{1000 * late_s:.0f} ms" if np.isfinite(late_s) else "no answer",
        allowed=f"{1000 * LATE_S:.0f} ms",
        cure="a slow network, or a program on the robot that holds states back",
    )  # fmt: skip


def _answer_s(motion: SoftMotion, hips: Floats, edge: int) -> float | None:
    step = motion.pulse[edge] - motion.pulse[edge - 1]
    later = hips[edge + 1 : edge + ticks_of(ANSWERS_S)] - hips[edge]
    answered = np.flatnonzero(later * np.sign(step) > 0.5 * abs(step))
    return (
        float(motion.time_s[edge + 1 + answered[0]] - motion.time_s[edge])
        if answered.size
        else None
    )
