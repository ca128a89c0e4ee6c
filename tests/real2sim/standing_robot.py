"""Run logs of a robot on the ground, made by the plant
with effects in it and noise on its sensors.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from samples import KINEMATICS, ROBOT

from saltus.constants import PHYSICS_DT
from saltus.effects.effect import Effect
from saltus.effects.profile import IDEAL
from saltus.joint_command import JointCommand
from saltus.recordings.run_log import JointTable, LogTable, RunLog
from saltus.robots.robot import JOINTS
from saltus.rotations import quaternion_from_roll_pitch_yaw, rotation_matrix
from saltus.sim.plant import Plant
from saltus.terrain import flat

KP, KD = 100.0, 2.0
DT = PHYSICS_DT
NOISE = {
    "q": 1e-3,
    "dq": 0.05,
    "tau": 0.2,
    "position": 1e-3,
    "tilt": 2e-3,
    "velocity": 0.02,
    "gyro": 0.01,
    "acc": 0.1,
}
STAND_FEET = np.asarray(KINEMATICS.position(ROBOT.stand_pose))


@dataclass(frozen=True, kw_only=True)
class Motion:
    """What the body shall do: amplitudes of sines about a stand."""

    name: str
    duration_s: float
    frequency_hz: float = 1.0
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0
    hops: bool = False
    drop_m: float | None = None

    def commands(self) -> np.ndarray:
        """Desired joint angles, shape (n, 12)."""
        t = DT * np.arange(round(self.duration_s / DT))
        wave = np.sin(2.0 * np.pi * self.frequency_hz * t) * np.minimum(
            1.0, np.minimum(t, t[-1] - t) / 0.3
        )
        if self.hops:
            wave = np.interp(
                t % 1.0,
                [0.0, 0.15, 0.3, 0.4, 0.48, 0.58, 0.75, 1.0],
                [0, -0.5, -1, -1, 0.6, 0.6, 0, 0],
            )
        shift = wave[:, None] * np.array([self.x, self.y, self.z])
        rotation = rotation_matrix(
            quaternion_from_roll_pitch_yaw(self.roll * wave, self.pitch * wave, 0.0 * wave)
        )
        feet = (STAND_FEET - shift[:, None, :]) @ rotation
        return np.asarray(KINEMATICS.inverse(feet))


MOTIONS = (
    Motion(name="stand", duration_s=1.5),
    Motion(name="squat", duration_s=2.0, frequency_hz=1.0, z=0.04),
    Motion(name="squat", duration_s=2.0, frequency_hz=1.0, z=0.04),
    Motion(name="quick squat", duration_s=2.0, frequency_hz=2.0, z=0.03),
    Motion(name="pitch", duration_s=2.0, frequency_hz=1.5, pitch=0.15),
    Motion(name="roll", duration_s=2.0, frequency_hz=1.5, roll=0.15),
    Motion(name="sideways", duration_s=2.0, frequency_hz=2.5, y=0.035),
    Motion(name="lengthways", duration_s=2.0, frequency_hz=2.5, x=0.035),
    Motion(name="hop", duration_s=2.0, z=0.05, hops=True),
    Motion(name="drop", duration_s=1.0, drop_m=0.05),
    Motion(name="drop", duration_s=1.0, drop_m=0.10),
)


def run_log(
    effects: Sequence[Effect[Any]] = (),
    *,
    motions: Sequence[Motion] = MOTIONS,
    seed: int = 0,
    noise: float = 1.0,
    base: bool = True,
) -> RunLog:
    """Lets a robot with `effects` move; `noise` scales that of all sensors."""
    profile = IDEAL.having(*effects)
    plant = Plant(
        ROBOT,
        flat.make(),
        chain=profile.actuator_chain,
        body=profile.body_chain,
        imu=profile.imu_chain,
    )
    zero, gains = np.zeros(12), (np.full(12, KP), np.full(12, KD))
    rows: list[np.ndarray] = []
    segments = []

    def step(q_des: np.ndarray, keep: bool = True) -> None:
        now, imu = plant.state, plant.imu
        quaternion = now.quaternion_base_in_world
        command = JointCommand(position=q_des, velocity=zero, kp=gains[0], kd=gains[1], torque=zero)
        after = plant.step(command)
        if keep:
            rows.append(
                np.concatenate(
                    [
                        now.joint_position,
                        now.joint_velocity,
                        q_des,
                        after.joint_torque,
                        imu.quaternion_base_in_world,
                        imu.angular_velocity_base,
                        imu.acceleration_base,
                        now.position_base_in_world,
                        quaternion,
                        now.velocity_base_in_world,
                        now.foot_force,
                    ]
                )
            )

    plant.reset()
    for _ in range(250):
        step(ROBOT.stand_pose, keep=False)
    for motion in motions:
        if motion.drop_m is not None:
            plant.reset(clearance=motion.drop_m)
        start = len(rows)
        for q_des in motion.commands():
            step(q_des)
        segments.append(
            {
                "name": f"{motion.name} {len(segments)}",
                "t0": start * DT,
                "t1": len(rows) * DT,
                "condition": motion.name,
            }
        )
    return _noisy(np.array(rows), segments, np.random.default_rng(seed), noise, base)


def _noisy(
    rows: np.ndarray,
    segments: list[dict[str, Any]],
    rng: np.random.Generator,
    scale: float,
    base: bool,
) -> RunLog:
    time_s = DT * np.arange(len(rows))
    q, dq, q_des, tau, imu_q, gyro, acc, position, quaternion, velocity, feet = np.split(
        rows, np.cumsum([12, 12, 12, 12, 4, 3, 3, 3, 4, 3]), axis=1
    )

    def noisy(values: np.ndarray, kind: str) -> np.ndarray:
        return values + scale * NOISE[kind] * rng.standard_normal(values.shape)

    def turned(values: np.ndarray) -> np.ndarray:
        angle = scale * NOISE["tilt"] * rng.standard_normal((len(values), 3))
        return _normalised(
            values
            + 0.5 * _times(values, np.concatenate([np.zeros((len(values), 1)), angle], axis=1))
        )

    meta = {
        "schema": "saltus-run/1",
        "robot": "go1",
        "base": "free",
        "joints": list(JOINTS),
        "kp": KP,
        "kd": KD,
        "control_dt": DT,
        "segments": segments,
        "terrain": "flat",
    }
    zeros = np.zeros_like(q)
    joints = JointTable(
        time_s=time_s,
        q=noisy(q, "q"),
        dq=noisy(dq, "dq"),
        q_des=q_des,
        dq_des=zeros,
        tau_ff=zeros,
        tau_est=noisy(tau, "tau"),
    )
    imu = np.concatenate([turned(imu_q), noisy(gyro, "gyro"), noisy(acc, "acc")], axis=1)
    motion = np.concatenate(
        [noisy(position, "position"), turned(quaternion), noisy(velocity, "velocity")], axis=1
    )
    return RunLog(
        meta=meta,
        joints=joints,
        imu=LogTable(time_s=time_s, values=imu),
        base=LogTable(time_s=time_s, values=motion) if base else None,
        feet=LogTable(time_s=time_s, values=np.round(feet)),
    )


def _times(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Hamilton product of quaternions, shape (n, 4)."""
    w = a[:, :1] * b[:, :1] - np.sum(a[:, 1:] * b[:, 1:], axis=1, keepdims=True)
    return np.concatenate(
        [w, a[:, :1] * b[:, 1:] + b[:, :1] * a[:, 1:] + np.cross(a[:, 1:], b[:, 1:])], axis=1
    )


def _normalised(values: np.ndarray) -> np.ndarray:
    return np.asarray(values / np.linalg.norm(values, axis=1, keepdims=True))
