"""real2sim beside `mujoco.sysid`, on a question that both can answer:
armature, damping and friction of the calves.

Three effects are hidden in a held robot and one log of joint chirps is written. `mujoco.sysid` is
told which three parameters are unknown and fits them by rollouts of the engine from measured
states; real2sim is told nothing. Both values come with their 90 % intervals. Needs `pip install
"mujoco[sysid]"`.

    saltus bench sysid -- --seed 0
"""

import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import mujoco
import numpy as np
from scipy import stats

from benchmarks._command import Command, tell
from saltus.arrays import Floats
from saltus.effects.joint_loads import Armature, CoulombFriction, ViscousFriction
from saltus.effects.profile import Profile
from saltus.real2sim.experiments.menu import experiment_named
from saltus.real2sim.experiments.run import SensorNoise, run_experiment
from saltus.real2sim.pipeline import find_in_logs
from saltus.recordings.run_log import RunLog, write_run_log
from saltus.robots.loading import load_robot
from saltus.robots.robot import LEGS
from saltus.robots.shipped import DEFAULT_ROBOT
from saltus.sim import robot_model
from saltus.sim.plant import HELD_HEIGHT, HELD_INERTIA, HELD_TOLERANCE
from saltus.terrain import flat

if TYPE_CHECKING:
    from mujoco.sysid import Parameter, ParameterDict

CALVES = np.arange(12) % 3 == 2
HIDDEN = {"armature": 0.004, "viscous_friction": 0.15, "coulomb_friction": 0.25}
"""Added at the calves [kg m^2, Nm s/rad, Nm]: middling for robots of this class (published)."""
LARGEST = {"armature": 0.02, "viscous_friction": 1.0, "coulomb_friction": 1.0}
RESTART_ROWS, FORGOTTEN_ROWS = 500, 100
"""Each second a rollout starts at the measured state.

Its noise is forgotten after 0.2 s of feedback.
"""
ROBOT = load_robot(DEFAULT_ROBOT)
NOISE = SensorNoise()
QUANTILE = float(stats.norm.ppf(0.95))


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    seed: int = 0
    """Seed of the sensors' noise."""

    def measure(self) -> dict[str, Any]:
        """Value and interval of each effect."""
        log = run_experiment(experiment_named("joint_chirp"), ROBOT, _effects(), seed=self.seed)
        figures: dict[str, Any] = {"hidden": HIDDEN}
        for name, way in (("mujoco.sysid", _by_sysid), ("real2sim", _by_real2sim)):
            start = time.process_time()
            found = way(log)
            figures[name] = {
                effect: {
                    "value": value,
                    "low": low,
                    "high": high,
                    "holds": low <= HIDDEN.get(effect, 0.0) <= high,
                }
                for effect, (value, low, high) in found.items()
            }
            figures[f"{name}_cpu_s"] = round(time.process_time() - start, 1)
        return figures


def _effects() -> Profile:
    def spread(name: str) -> tuple[float, ...]:
        return tuple(np.where(CALVES, HIDDEN[name], 0.0).tolist())

    return Profile(
        actuator=(
            Armature(added=spread("armature")),
            ViscousFriction(coefficient=spread("viscous_friction")),
            CoulombFriction(torque=spread("coulomb_friction")),
        )
    )


def _by_real2sim(log: RunLog) -> dict[str, tuple[float, float, float]]:
    with tempfile.TemporaryDirectory() as folder:
        write_run_log(log, Path(folder) / "log")
        verdict = find_in_logs([Path(folder) / "log"], Path(folder), report=False).verdict
    tell(f"real2sim says {verdict.verdict}: {', '.join(effect.name for effect in verdict.effects)}")
    found = {}
    for effect in verdict.effects:
        interval = next(iter(effect.params.values()))
        found[effect.name] = (interval.value, *interval.ci90)
    return found


def _by_sysid(log: RunLog) -> dict[str, tuple[float, float, float]]:
    from mujoco.sysid import Parameter, ParameterDict, calculate_intervals, optimize

    unknown = ParameterDict()
    for name, largest in LARGEST.items():
        unknown.add(
            Parameter(
                name,
                nominal=0.1 * largest,
                min_value=0.0,
                max_value=largest,
                modifier=_modifier(name),
            )
        )

    def residuals(x: Floats, params: ParameterDict) -> tuple[list[Floats], None, None]:
        params.update_from_vector(x)
        return [_apart(log, _model(params))], None, None

    params, result = optimize(unknown, residuals, optimizer="scipy", verbose=False)
    covariance, _ = calculate_intervals([residuals(result.x, params)[0][0]], result.jac)
    error = np.sqrt(np.diag(covariance))
    return {
        name: (float(x), float(x - QUANTILE * e), float(x + QUANTILE * e))
        for name, x, e in zip(LARGEST, result.x, error, strict=True)
    }


def _modifier(name: str) -> Callable[[mujoco.MjSpec, "Parameter"], None]:
    def modify(spec: mujoco.MjSpec, parameter: "Parameter") -> None:
        for leg, joint in enumerate(np.flatnonzero(CALVES)):
            hinge = spec.joint(f"{LEGS[leg]}_calf")
            added = float(parameter.value[0])
            if name == "armature":
                hinge.armature = float(ROBOT.armature[joint]) + added
            elif name == "viscous_friction":
                hinge.damping = np.array([added, 0.0, 0.0])  # linear, quadratic and cubic in speed
            else:
                hinge.frictionloss = added

    return modify


def _model(params: "ParameterDict") -> mujoco.MjModel:
    spec = robot_model.build_spec(ROBOT, flat.make())
    for name in LARGEST:
        params[name].apply_modifier(spec)
    model = spec.compile()
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    model.opt.tolerance = HELD_TOLERANCE
    model.dof_armature[:6] = HELD_INERTIA
    return model


def _apart(log: RunLog, model: mujoco.MjModel) -> Floats:
    """Measured minus simulated in units of the sensors' noise."""
    joints, kp, kd = log.joints, cast(float, log.meta["kp"]), cast(float, log.meta["kd"])
    assert joints.dq is not None
    assert joints.dq_des is not None
    data = mujoco.MjData(model)
    apart = []
    for start in range(0, len(joints.q) - RESTART_ROWS, RESTART_ROWS):
        mujoco.mj_resetData(model, data)
        data.qpos[2], data.qpos[7:], data.qvel[6:] = HELD_HEIGHT, joints.q[start], joints.dq[start]
        for row in range(start, start + RESTART_ROWS):
            q, dq = data.qpos[7:].copy(), data.qvel[6:].copy()
            if row - start >= FORGOTTEN_ROWS:
                apart += [(joints.q[row] - q) / NOISE.q_rad, (joints.dq[row] - dq) / NOISE.dq_rad_s]
            data.ctrl[:] = kp * (joints.commanded_q[row] - q) + kd * (joints.dq_des[row] - dq)
            mujoco.mj_step(model, data)
    return np.concatenate(apart)
