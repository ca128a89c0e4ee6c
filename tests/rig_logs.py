"""Run logs of a simulated rig: twelve joints under PD control with gravity, body and camera.

For tests of real2sim.
"""

from collections.abc import Sequence
from dataclasses import astuple, dataclass
from functools import cache
from typing import Any

import numpy as np
from samples import ROBOT

from saltus.arrays import Floats
from saltus.recordings.run_log import DepthTable, JointTable, LogTable, RunLog
from saltus.robots.robot import JOINTS

DT = 0.002
INERTIA = np.tile([0.05, 0.05, 0.015], 4)
WEIGHT = np.tile([0.3, 0.5, 0.3], 4)  # Nm of gravity at a horizontal link
# Nm that hold the legs of a Go1 beside its hips
HIP_WEIGHT = np.tile([0.69, 0.0, 0.0], 4) * np.repeat(ROBOT.side, 3)
CAMERA: dict[str, Any] = {
    "fx": 40.0, "fy": 40.0, "cx": 32.0, "cy": 24.0, "width": 64, "height": 48,
    "position": [0.27, 0.0, 0.09], "pitch": 0.52, "rate": 50.0, "latency": 0.05, "range_max": 3.0,
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Rig:
    """What the made-up robot does differently from its claim."""

    delay_s: float = 0.0
    gain: float = 1.0
    viscous: float = 0.0
    coulomb: float = 0.0
    bias: float = 0.0
    play: float = 0.0
    kp: float = 20.0
    kd: float = 0.5


def motion(seconds: float) -> tuple[Floats, Floats]:
    """Times, and commands of 12 joints: a slow part, a chirp to 8 Hz, steps.

    Joints out of phase.
    """
    time_s = np.arange(0.0, seconds, DT)
    phase = np.arange(12) * 0.7
    part = time_s / seconds
    slow = 0.25 * np.sin(2 * np.pi * 0.4 * time_s[:, None] + phase)
    chirp = 0.15 * np.sin(
        2 * np.pi * (0.5 * time_s + 8 / seconds * (time_s - 0.4 * seconds) ** 2)[:, None] + phase
    )
    steps = 0.3 * np.sign(np.sin(2 * np.pi * 0.8 * time_s[:, None] + phase))
    moved = np.where(part[:, None] < 0.4, slow, np.where(part[:, None] < 0.7, chirp, steps))
    return time_s, ROBOT.stand_pose + moved


def joints_log(rig: Rig = Rig(), *, seconds: float = 12.0, seed: int = 0) -> RunLog:
    """A log of a robot whose base is held."""
    return joints_logs((rig,), seconds=seconds, seed=seed)[0]


def joints_logs(rigs: Sequence[Rig], *, seconds: float = 12.0, seed: int = 0) -> list[RunLog]:
    """Logs of several robots, which are simulated together."""
    time_s, q_des = motion(seconds)
    return [
        _noisy(time_s, q_des, *rows, seed)
        for rows in zip(*_simulate(tuple(rigs), seconds), strict=True)
    ]


def _noisy(
    time_s: Floats, q_des: Floats, q: Floats, dq: Floats, torque: Floats, seed: int
) -> RunLog:
    rng = np.random.default_rng(seed)
    joints = JointTable(
        time_s=time_s,
        q=q + rng.normal(0, 1e-3, q.shape),
        q_des=q_des,
        dq=dq + rng.normal(0, 0.05, q.shape),
        dq_des=np.zeros_like(q),
        tau_ff=np.zeros_like(q),
        tau_est=torque + rng.normal(0, 0.2, q.shape),
    )
    meta: dict[str, Any] = {
        "schema": "saltus-run/1", "robot": "go1", "base": "fixed", "joints": list(JOINTS),
        "kp": 20.0, "kd": 0.5, "control_dt": DT, "terrain": "flat",
    }  # fmt: skip
    return RunLog(meta=meta, joints=joints)


@cache  # several files ask for one robot
def _simulate(rigs: tuple[Rig, ...], seconds: float) -> tuple[Floats, Floats, Floats]:
    """Readings of q, rate and the torque that the drives believe,
    (rigs, rows, 12); half a millisecond a step.
    """
    time_s, q_des = motion(seconds)
    delay_s, gain, viscous, coulomb, bias, play, kp, kd = np.array(
        [astuple(rig) for rig in rigs]
    ).T[..., None]
    whole, part = np.divmod(np.round(delay_s / DT, 6), 1.0)
    sent = np.maximum(np.arange(len(time_s)) - whole.astype(int), 0)
    late = (1.0 - part)[..., None] * q_des[sent] + part[..., None] * q_des[np.maximum(sent - 1, 0)]
    late = late.transpose(1, 0, 2).copy()
    steps = 4
    q, dq, side = (
        np.tile(q_des[0], (len(rigs), 1)),
        np.zeros((len(rigs), 12)),
        np.zeros((len(rigs), 12)),
    )
    rows = np.empty((3, len(time_s), *q.shape))
    for row in range(len(time_s)):
        reading = q + bias + play * side
        torque = kp * (late[row] - reading) - kd * dq
        rows[:, row] = reading, dq, torque
        side = np.clip(side + np.sign(torque) * 0.1, -0.5, 0.5)
        for _ in range(steps):
            torque = kp * (late[row] - q - bias - play * side) - kd * dq
            friction = viscous * dq + coulomb * np.tanh(dq / 0.05)
            dq = dq + DT / steps / INERTIA * (
                gain * torque - friction - WEIGHT * np.sin(q) - HIP_WEIGHT
            )
            q = q + DT / steps * dq
    q, dq, torque = rows.transpose(0, 2, 1, 3)
    return q, dq, torque


def body_log(*, seconds: float = 8.0, seed: int = 0) -> RunLog:
    """A log of a body that heaves and rocks, with IMU,
    motion capture and a depth camera over a floor.
    """
    rng = np.random.default_rng(seed)
    log = joints_log(seconds=1.0)
    time_s = np.arange(0.0, seconds, DT)
    rows = len(time_s)
    still = {name: np.zeros((rows, 12)) for name in ("q", "q_des", "dq")}
    joints = JointTable(time_s=time_s, **still)
    z = 0.27 + 0.04 * np.sin(2 * np.pi * 0.9 * time_s)
    vz = np.gradient(z, time_s)
    pitch = 0.1 * np.sin(2 * np.pi * 0.7 * time_s)
    yaw = 0.1 * np.sin(2 * np.pi * 0.5 * time_s)
    quaternion = np.stack(
        [_product(_turn(2, b), _turn(1, a)) for a, b in zip(pitch, yaw, strict=True)]
    )
    rate, turn = np.gradient(pitch, time_s), np.gradient(yaw, time_s)
    gyro = np.stack([-np.sin(pitch) * turn, rate, np.cos(pitch) * turn], axis=1)
    force = 9.81 + np.gradient(vz, time_s)
    acceleration = np.stack([-np.sin(pitch) * force, 0 * pitch, np.cos(pitch) * force], axis=1)
    noise = rng.normal(size=(rows, 6)) * np.array([0.01] * 3 + [0.1] * 3)
    imu = np.concatenate([quaternion, np.concatenate([gyro, acceleration], axis=1) + noise], axis=1)
    zero = np.zeros(rows)
    base = np.column_stack([0.1 * z, zero, z, quaternion, 0.1 * vz, zero, vz])
    meta = {**log.meta, "base": "free", "camera": CAMERA}
    depth = _images(time_s, base, rng)
    return RunLog(
        meta=meta,
        joints=joints,
        imu=LogTable(time_s=time_s, values=imu),
        base=LogTable(time_s=time_s, values=base),
        depth=depth,
    )


def _turn(axis: int, angle: float) -> Floats:
    quaternion = np.zeros(4)
    quaternion[0], quaternion[1 + axis] = np.cos(angle / 2), np.sin(angle / 2)
    return quaternion


def _product(a: Floats, b: Floats) -> Floats:
    vector = a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])
    return np.concatenate([[a[0] * b[0] - a[1:] @ b[1:]], vector])


def _images(time_s: Floats, base: Floats, rng: np.random.Generator) -> DepthTable:
    """Images of a flat floor, 50 ms old at arrival, by a camera that forgets yaw: it is small."""
    capture = time_s[:-50:10]
    rows = np.searchsorted(time_s, capture)
    v = (np.arange(48) + 0.5 - CAMERA["cy"]) / CAMERA["fy"]
    pitch = 2 * base[rows, 5]  # sine of half the angle
    angle = CAMERA["pitch"] + pitch[:, None] + np.arctan(v)
    height = base[rows, 2] + CAMERA["position"][2] - np.sin(pitch) * CAMERA["position"][0]
    with np.errstate(divide="ignore"):
        distance = height[:, None] / np.sin(angle) * np.cos(np.arctan(v))
    distance = np.where((np.sin(angle) > 0) & (distance < 3), distance, 0)
    images = np.repeat(distance[:, :, None], 64, axis=2)
    images = np.where(images > 0, images * (1 + rng.normal(0, 0.003, images.shape)), 0)
    return DepthTable(
        arrival_s=capture + 0.05, capture_s=capture, frame_id=np.arange(len(capture)),
        depth_mm=np.rint(1e3 * images).astype(np.uint16),
    )  # fmt: skip
