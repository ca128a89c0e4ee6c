"""Runs of joints: places of effects and files."""

import numpy as np

from benchmarks.hidden_effects import experiments
from benchmarks.hidden_effects.joints import JointScene, draw_where
from benchmarks.hidden_effects.plan import Run
from benchmarks.hidden_effects.robot import LEGS, Floats
from benchmarks.hidden_effects.scene import Scene, Setting
from benchmarks.hidden_effects.stage import Stage
from benchmarks.hidden_effects.tables import RunFiles, claim, joint_columns


class JointStage(Stage):
    """One leg stands for all in what is measured of effects:
    the others are the same leg mirrored.
    """

    def __init__(self, run: Run, tuning: bool) -> None:
        self._rng = np.random.default_rng(run.seed + 1)
        self.place = draw_where(self._rng)
        leg = next(
            number
            for number, name in enumerate(LEGS)
            if any(j.startswith(name) for j in self.place)
        )
        self._joints = JointScene(run.seed, tuning=tuning, quiet=run.quiet, legs=(leg,))
        self.scene: Scene = self._joints
        self.sizing: Scene = self._joints
        if run.quiet:  # sizes and knees are those of the motion that would show them
            full = JointScene(run.seed, tuning=tuning, quiet=False, legs=(leg,))
            self._joints.peak, self.sizing = full.peak, full

    def where(self, effect: str, rng: np.random.Generator) -> tuple[str, ...]:
        del effect
        return self.place if rng.uniform() < 0.5 else self._other(rng)

    def follow(self, experiment: str, rng: np.random.Generator) -> bool:
        if experiment not in experiments.JOINTS:
            return False
        command, segments = experiments.joint_commands(experiment, self._joints.rig.control_dt, rng)
        self._joints.perform(command, segments, experiments.STIFFER.get(experiment, 1.0))
        return True

    def record(self, settings: tuple[Setting, ...], rng: np.random.Generator) -> RunFiles:
        rig = self._joints.rig
        start = rng.uniform(0, 1000)
        t = start + np.arange(len(rig.command)) * rig.control_dt
        meta = claim(
            base="fixed",
            kp=rig.kp,
            kd=rig.kd,
            control_dt=rig.control_dt,
            segments=self._joints.segments,
            start_s=start,
        )
        measured: Floats = self._joints.measure(settings, rng)
        return RunFiles(meta=meta, tables={"joints": joint_columns(t, measured, rig.command)})

    def _other(self, rng: np.random.Generator) -> tuple[str, ...]:
        """Another place that has a joint of the leg that is simulated."""
        leg = LEGS[self._joints.legs[0]]
        while True:
            where = draw_where(rng)
            if any(joint.startswith(leg) for joint in where):
                return where
