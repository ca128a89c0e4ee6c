"""Checks of what a robot says while it is only listened to."""

from collections.abc import Callable
from dataclasses import dataclass
from math import radians

import numpy as np

from saltus.arrays import Floats
from saltus.constants import GRAVITY, PHYSICS_DT
from saltus.controller.robot.unitree.drives import reading_of
from saltus.controller.robot.unitree.link import COMMANDS, STATES, UnitreeLink
from saltus.controller.robot.unitree.messages import LOW_STATE, MOTORS, UnitreeMessage
from saltus.controller.robot.unitree.states import LOST_S, TICK_MS, StateWatch
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import JOINTS, Robot
from saltus.rotations import roll_pitch_yaw, rotation_matrix

LISTENS_S = 2.0
RATE_HZ = (475.0, 525.0)
"""States a second: 500, and what a computer that lends its time to others does to two seconds."""
LOST_SHARE = 0.01
"""Share of the states; on a cable between two computers none are lost."""
HOT_C, CHARGE_PERCENT, CELL_MV = 70, 20, 3300
"""Choices, with room for a session: no source says where a Go2 itself switches off."""
BEYOND_RAD = 0.05
"""Encoders and stops of a real Go2 are off by less (its log in the air, docs/real_logs.md)."""
G_ERROR, TURNS, ASKEW_RAD = 0.5, 0.1, radians(3.0)
"""Accelerometer [m/s^2], gyroscope [rad/s], and the one's down against the other's, at rest."""
HANGS_LEVEL_RAD, STANDS_LEVEL_RAD = radians(12.0), radians(4.0)
"""Trunk of a robot that was hung up level by eye; the plane of feet that stand, by legs and IMU."""
ON_PLANE_M = 0.004
"""Feet are no farther from the plane through all: a quarter of what one is off the other three."""


@dataclass(frozen=True, kw_only=True)
class PreflightCheck:
    """One line of a preflight: its name, whether it passed, and what was seen."""

    name: str
    passed: bool
    found: str
    """Measured value, with unit."""
    allowed: str
    """Values with which it passes."""
    cure: str
    """Likely cause and next step where it does not."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ListenedStates:
    """States of a robot that was listened to for a while, and sent nothing."""

    messages: UnitreeMessage
    """States that were taken over, shape (n,)."""
    watch: StateWatch
    span_s: float
    """Time from the first to the last [s], by our clock."""
    others: tuple[str, ...]
    """Other programs that command the robot."""


def listen_to_robot(
    link: UnitreeLink, wait: Callable[[], float], seconds: float = LISTENS_S
) -> ListenedStates:
    """Takes states for some seconds; `wait` returns the time 2 ms after its last return [s]."""
    watch, kept, times = StateWatch(), [], []
    begin_s = now_s = wait()
    link.take(STATES)  # what came before is of another time
    while now_s < begin_s + seconds:
        for arrived in link.take(STATES):
            if watch.take([arrived.payload], now_s) and watch.message is not None:
                kept.append(watch.message)
                times.append(now_s)
        watch.judge(now_s)
        now_s = wait()
    messages = np.stack(kept) if kept else np.zeros(0, LOW_STATE.dtype)
    span_s = times[-1] - times[0] if times else 0.0
    return ListenedStates(
        messages=messages, watch=watch, span_s=span_s, others=link.others(COMMANDS)
    )


def link_checks(heard: ListenedStates, its_own: int = 0) -> list[PreflightCheck]:
    """Checks of the link, without which nothing else means anything.

    `its_own` is the number of programs that may command it: of its own motion service, if it is
    only listened to.
    """
    health, count = heard.watch.health, len(heard.messages)
    damaged = health.bad.get("crc", 0) + health.bad.get("size", 0)
    rate_hz = (count - 1) / heard.span_s if heard.span_s > 0.0 else 0.0
    share = health.lost / max(1, count + health.lost)
    old = health.bad.get("old", 0)
    return [
        PreflightCheck(
            name="alone", passed=len(heard.others) <= its_own,
            found=", ".join(heard.others) or "nobody else",
            allowed="no other program that commands the robot",
            cure="end that program",
        ),
        PreflightCheck(
            name="checksums", passed=damaged == 0, found=f"{damaged} wrong", allowed="none",
            cure="another robot's protocol, or a damaged cable",
        ),
        PreflightCheck(
            name="rate", passed=RATE_HZ[0] <= rate_hz <= RATE_HZ[1], found=f"{rate_hz:.0f} Hz",
            allowed=f"{RATE_HZ[0]:.0f} to {RATE_HZ[1]:.0f} Hz",
            cure="is the robot on, and --interface the one it hangs on? Is this computer too slow?",
        ),
        PreflightCheck(
            name="gaps", passed=share <= LOST_SHARE, found=f"{100 * share:.1f} % lost",
            allowed=f"{100 * LOST_SHARE:.0f} %", cure="cable and switch; no wireless link",
        ),
        PreflightCheck(
            name="clock", passed=not (heard.watch.fault or old),
            found=heard.watch.fault or f"{old} states came again or out of order",
            allowed=f"new states {TICK_MS} ms apart, within {1000 * LOST_S:.0f} ms",
            cure="start the robot again; is there a second one in this domain?",
        ),
    ]  # fmt: skip


def state_checks(heard: ListenedStates, robot: Robot, *, stands: bool) -> list[PreflightCheck]:
    """Checks of what the robot says of itself: battery, motors, joints and IMU, at rest."""
    messages, last = heard.messages, heard.messages[-1]
    hottest = int(np.argmax(last["motor_state"]["temperature"][:MOTORS]))
    heat = int(last["motor_state"]["temperature"][hottest])
    charge, cells = int(last["bms_state"]["soc"]), last["bms_state"]["cell_vol"]
    cell = int(cells[cells > 0].min()) if (cells > 0).any() else 0
    readings = [
        reading_of(message, robot).measurement for message in messages[:: len(messages) // 50 or 1]
    ]
    position = np.mean([each.joint_position for each in readings], axis=0)
    beyond = np.maximum(robot.joint_lower - position, position - robot.joint_upper)
    worst = int(np.argmax(beyond))
    return [
        PreflightCheck(
            name="battery", passed=charge >= CHARGE_PERCENT and cell >= CELL_MV,
            found=f"{charge} %, lowest cell {1e-3 * cell:.2f} V",
            allowed=f"{CHARGE_PERCENT} %, {1e-3 * CELL_MV:.1f} V", cure="charge it",
        ),
        PreflightCheck(
            name="temperatures", passed=heat <= HOT_C, found=f"{JOINTS[hottest]} {heat} C",
            allowed=f"{HOT_C} C", cure="let it cool down; a motor that stays hot is blocked",
        ),
        PreflightCheck(
            name="ranges", passed=bool(beyond[worst] <= BEYOND_RAD),
            found=f"{JOINTS[worst]} at {position[worst]:+.2f} rad",
            allowed=f"{robot.joint_lower[worst]:+.2f} to {robot.joint_upper[worst]:+.2f} rad",
            cure="its sign or its zero is wrong, or the joints are in another order",
        ),
        *_imu_checks(
            np.mean([each.acceleration_base for each in readings], axis=0),
            np.mean([each.angular_velocity_base for each in readings], axis=0),
            readings[-1].quaternion_base_in_world, position, robot, stands=stands,
        ),
    ]  # fmt: skip


def _imu_checks(
    acceleration: Floats,
    turning: Floats,
    quaternion: Floats,
    position: Floats,
    robot: Robot,
    *,
    stands: bool,
) -> list[PreflightCheck]:
    g, turns = float(np.linalg.norm(acceleration)), float(np.linalg.norm(turning))
    up = rotation_matrix(quaternion)[2]  # of the world, in the base
    askew = _angle(acceleration, up)
    checks = [
        PreflightCheck(
            name="imu",
            passed=abs(g - GRAVITY) <= G_ERROR and turns <= TURNS and askew <= ASKEW_RAD,
            found=f"{g:.2f} m/s2, {turns:.2f} rad/s, {np.rad2deg(askew):.1f} deg askew",
            allowed=f"{GRAVITY - G_ERROR:.1f} to {GRAVITY + G_ERROR:.1f} m/s2, {TURNS} rad/s, "
            f"{np.rad2deg(ASKEW_RAD):.0f} deg",
            cure="keep it still; else its IMU is broken",
        )
    ]  # fmt: skip
    if not stands:
        roll, pitch, _ = roll_pitch_yaw(rotation_matrix(quaternion))
        tilt = max(abs(float(roll)), abs(float(pitch)))
        return [*checks, PreflightCheck(
            name="level", passed=tilt <= HANGS_LEVEL_RAD, found=f"{np.rad2deg(tilt):.0f} deg",
            allowed=f"{np.rad2deg(HANGS_LEVEL_RAD):.0f} deg",
            cure="hang it up level; if it is, the IMU is turned in it",
        )]  # fmt: skip
    feet = LegKinematics(robot).position(position)
    normal, off = _plane(feet)
    tilt = _angle(normal, up)
    return [*checks, PreflightCheck(
        name="legs", passed=tilt <= STANDS_LEVEL_RAD and off <= ON_PLANE_M,
        found=f"ground {np.rad2deg(tilt):.1f} deg off level, a foot {1000 * off:.0f} mm off it",
        allowed=f"{np.rad2deg(STANDS_LEVEL_RAD):.0f} deg, {1000 * ON_PLANE_M:.0f} mm",
        cure="stand it on level ground; else a joint's zero or sign is wrong, or the IMU is turned",
    )]  # fmt: skip


def _plane(feet: Floats) -> tuple[Floats, float]:
    """Upward normal of the plane through four feet, and how far the worst is off it [m]."""
    centred = feet - feet.mean(axis=0)
    normal = np.linalg.svd(centred)[2][-1]
    normal = normal * np.sign(normal[2] or 1.0)
    return normal, float(np.abs(centred @ normal).max())


def _angle(one: Floats, other: Floats) -> float:
    cosine = one @ other / (np.linalg.norm(one) * np.linalg.norm(other))
    return float(np.arccos(np.clip(cosine, -1.0, 1.0)))


def ticks_of(seconds: float) -> int:
    """Ticks of 2 ms in some seconds."""
    return round(seconds / PHYSICS_DT)
