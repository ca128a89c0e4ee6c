"""Runs of the body and of the IMU: files."""

import numpy as np

from benchmarks.hidden_effects import experiments
from benchmarks.hidden_effects.body import (
    CONTROL_DT,
    FEET_EVERY,
    GROUND,
    PAYLOAD_POSITION,
    BodyScene,
    quaternions,
)
from benchmarks.hidden_effects.plan import Run
from benchmarks.hidden_effects.scene import Setting
from benchmarks.hidden_effects.stage import Stage
from benchmarks.hidden_effects.tables import BASE, FEET, IMU, RunFiles, claim, joint_columns

EVERY = 2
"""Rows of the control loop per row of motion capture: 250 Hz."""


class BodyStage(Stage):
    place = ("trunk",)

    def __init__(self, run: Run, tuning: bool) -> None:
        self._body = BodyScene(run.seed, tuning=tuning, imu=run.kind == "imu")
        self.scene = self._body
        self.sizing = self._body

    def follow(self, experiment: str, rng: np.random.Generator) -> bool:
        if experiment not in experiments.BODY:
            return False
        position, segments = experiments.body_commands(experiment, CONTROL_DT, rng)
        payload, release = (
            experiments.PAYLOAD_KG.get(experiment, 0.0),
            experiments.RELEASE.get(experiment, 0.0),
        )
        self._body.perform(position, segments, known_payload_kg=payload, release_m=release)
        return True

    def record(self, settings: tuple[Setting, ...], rng: np.random.Generator) -> RunFiles:
        scene, start = self._body, float(rng.uniform(0, 1000))
        clean = scene.read(settings)
        load = clean.pop("load")
        read = {name: scene.noise(name, values, rng) for name, values in clean.items()}
        t = start + np.arange(len(scene.position)) * CONTROL_DT
        measured = np.stack([read["q"], read["dq"], read["tau_est"]], axis=-1)
        command = np.stack([scene.position, scene.velocity, np.zeros_like(scene.position)], axis=-1)
        imu = np.concatenate([quaternions(read["imu_rpy"]), read["gyro"], read["acc"]], axis=1)
        base = np.concatenate(
            [read["x"], read["y"], read["z"], quaternions(read["rpy"]), read["velocity"]], axis=1
        )
        # raw counts of sensors that nobody has calibrated
        feet = np.rint(
            rng.uniform(30, 120, 4) + rng.uniform(1.2, 2.2, 4) * load + rng.normal(0, 3, load.shape)
        )
        gains = np.ones(12)
        meta = claim(
            base="free",
            kp=scene.kp * gains,
            kd=scene.kd * gains,
            control_dt=CONTROL_DT,
            segments=scene.segments,
            start_s=start,
        )
        if scene.known_payload_kg:
            meta["payload_kg"] = scene.known_payload_kg
        meta["ground"], meta["payload_position"] = dict(GROUND), list(PAYLOAD_POSITION)
        return RunFiles(
            meta=meta,
            tables={
                "joints": joint_columns(t, measured, command),
                "imu": {"t": t, **dict(zip(IMU, imu.T, strict=True))},
                "base": {"t": t[::EVERY], **dict(zip(BASE, base[::EVERY].T, strict=True))},
                "feet": {"t": t[::FEET_EVERY], **dict(zip(FEET, feet.T, strict=True))},
            },
        )
