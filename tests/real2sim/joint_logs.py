"""Logs of the joints of the plant, with effects hidden in it."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from samples import ROBOT
from scipy.signal import lfilter

from saltus.arrays import Floats
from saltus.constants import PHYSICS_DT
from saltus.effects.chain import ActuatorChain, BodyChain
from saltus.effects.effect import Effect
from saltus.joint_command import JointCommand
from saltus.recordings.run_log import JOINT_SIGNALS, JointTable, RunLog
from saltus.robots.robot import JOINTS
from saltus.sim.plant import Plant
from saltus.terrain import flat

DT = PHYSICS_DT
KP, KD = 40.0, 1.0
NOISE = (1e-3, 0.05, 0.2)  # rad, rad/s, Nm: typical of drives of this class


def commands() -> tuple[Floats, list[dict[str, Any]]]:
    """A chirp, a slow triangle, large steps and a ranking of holds, each twice."""
    t = np.arange(0.0, 1.5, DT)
    shapes = {
        "chirp": (np.sin(2.0 * np.pi * (0.5 * t + 3.0 * t**2)), (0.15, 0.2, 0.2)),
        "triangle": (2.0 * np.abs(((t / 0.75) % 2.0) - 1.0) - 1.0, (0.2, 0.3, 0.3)),
        "steps": (np.repeat([0.0, 1.0, -1.0], 250), (0.35, 0.9, 0.4)),
        "ranking": (np.repeat([0.0, 0.5, 1.0, 0.5, 0.0], 150), (0.1, 0.2, 0.2)),
    }
    parts, segments, start = [], [], 0.0
    for name, (shape, amplitude) in shapes.items():
        for repeat in range(2):
            parts.append(ROBOT.stand_pose + shape[:, None] * np.tile(amplitude, 4))
            end = start + len(shape) * DT
            segments.append({"name": f"{name}{repeat}", "t0": start, "t1": end, "condition": name})
            start = end
    return np.concatenate(parts), segments


@cache
def motion(
    *effects: Effect[Any], kp: float = KP, stretched: float = 0.0, integral: float = 0.0
) -> RunLog:
    """Motion of a held robot, without noise, with effects of drives and of what holds it.

    Knees may be told to be `stretched` by so much [rad]; drives may have an `integral` term
    [Nm/(rad s)], which belongs to no effect.
    """
    q_des, segments = commands()
    q_des = q_des + np.tile((0.0, 0.0, stretched), 4)
    stand = tuple(effect for effect in effects if effect.site == "stand")
    chain = ActuatorChain(tuple(effect for effect in effects if effect not in stand))
    plant = Plant(ROBOT, flat.make(), chain=chain, body=BodyChain(stand), held=True)
    zero, state = np.zeros(12), plant.state
    tau_ff = (
        0.8 * np.sin(2.0 * np.pi * 1.3 * (np.arange(len(q_des)) % 750) * DT)[:, None] * np.ones(12)
    )
    q, dq, tau_est = np.empty((3, len(q_des), 12))
    more = np.zeros(12)
    for k in range(len(q_des)):
        q[k], dq[k] = state.joint_position, state.joint_velocity
        more = more + integral * DT * (q_des[k] - q[k])
        torque = tau_ff[k] + more
        state = plant.step(
            JointCommand(
                position=q_des[k], velocity=zero, kp=zero + kp, kd=zero + KD, torque=torque
            )
        )
        tau_est[k] = state.joint_torque
    meta = {
        "schema": "saltus-run/1",
        "robot": "go1",
        "base": "fixed",
        "joints": list(JOINTS),
        "kp": kp,
        "kd": KD,
        "control_dt": DT,
        "excitation": {"text": "", "segments": segments},
        "terrain": "flat",
    }
    time_s = DT * np.arange(len(q_des))
    table = JointTable(
        time_s=time_s, q=q, q_des=q_des, dq=dq, dq_des=0.0 * q, tau_ff=tau_ff, tau_est=tau_est
    )
    return RunLog(meta=meta, joints=table)


def noisy(log: RunLog, correlation: float = 0.0, seed: int = 0) -> RunLog:
    """The log with noise on what is measured; `correlation` from one row to the next."""
    rng = np.random.default_rng(seed)
    signals = {}
    for name, spread in zip(("q", "dq", "tau_est"), NOISE, strict=True):
        noise = rng.standard_normal(log.joints.q.shape)
        noise = lfilter([np.sqrt(1.0 - correlation**2)], [1.0, -correlation], noise, axis=0)
        signals[name] = getattr(log.joints, name) + spread * noise
    return replace(log, joints=replace(log.joints, **signals))


def of_one_leg(log: RunLog) -> RunLog:
    """The log of the first leg alone."""
    own = {
        name: getattr(log.joints, name)[:, :3]
        for name in JOINT_SIGNALS
        if getattr(log.joints, name) is not None
    }
    return replace(
        log, meta={**log.meta, "joints": list(JOINTS[:3])}, joints=replace(log.joints, **own)
    )
