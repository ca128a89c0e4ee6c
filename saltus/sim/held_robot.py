"""Legs of a robot whose base is held in the air, linearised along a motion.

Open kinematic chains that hang from a fixed base, here called branches, do not feel each other.
Near a motion (q0, dq0, ddq0) the equation of motion M(q) ddq + h(q, dq) = torque becomes, to first
order in what differs from it,

    M(q0) ddq + offset + stiffness q + damping dq = torque

which is as exact near the motion as the full equation, and a hundred times cheaper to integrate
many times over.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.errors import ModelError, nearest_hint
from saltus.robots.robot import Robot
from saltus.sim import robot_model
from saltus.terrain import flat

SLOPE = 1e-5  # of an angle or a velocity: finite differences are then good to 1e-5 of their value
ROLL = "base_roll"  # joint of a base that may
CHUNK = 2048  # states that are evaluated at once


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearLegs:
    """Equation of motion of all branches at successive instants."""

    mass: Floats
    """With armature [kg m^2], shape (instants, branches, joints, joints)."""
    offset: Floats
    """[Nm], shape (instants, branches, joints)."""
    stiffness: Floats
    """[Nm/rad], shape (instants, branches, joints, joints)."""
    damping: Floats
    """[Nm s/rad], shape (instants, branches, joints, joints)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RollingBase:
    """Coupling of a base that may roll about its x axis and the joints along a motion,
    at n instants.

    Per angle [1/rad], rate [s/rad] and acceleration [s^2/rad] of the base, in this order; moments
    and torques in [Nm].
    """

    moment: Floats
    """Moment that holds the base still, shape (n,)."""
    on_base: Floats
    """Shape (n, 3)."""
    on_joints: Floats
    """Shape (n, branches, joints, 3)."""


class HeldRobot:
    """A robot whose base is held.

    Args:
        robot: One of ours, or the path of an MJCF file.
        joints: Names of its joints; "FR_hip" also finds "FR_hip_joint".
        base_quaternion: (w, x, y, z) of the base, body to world.

    Attributes:
        branches: Indices into `joints` of each open chain, from the base outwards, shape (branches,
            joints each).
        armature: Claimed rotor inertia [kg m^2], shape (joints,).
        lower, upper: Claimed limits of the joints [rad], shape (joints,).

    Raises:
        ModelError: the model cannot be read, lacks a joint, or has branches of unequal length.
    """

    def __init__(
        self,
        robot: Robot | Path,
        joints: Sequence[str],
        base_quaternion: Sequence[float] = (1, 0, 0, 0),
    ) -> None:
        self._source = robot, np.asarray(base_quaternion, dtype=np.float64)
        self._model = _held_model(*self._source)
        self._dof = np.array([_dof(self._model, name) for name in joints])
        self.branches = _branches(self._model, self._dof)
        self.armature = self._model.dof_armature[self._dof].copy()
        limits = self._model.jnt_range[self._model.dof_jntid[self._dof]]
        is_limited = self._model.jnt_limited[self._model.dof_jntid[self._dof]].astype(bool)
        self.lower = np.where(is_limited, limits[:, 0], -np.inf)
        self.upper = np.where(is_limited, limits[:, 1], np.inf)
        self._batch: Batch | None = None

    def along(
        self, position: Floats, velocity: Floats, acceleration: Floats, every: int = 1
    ) -> LinearLegs:
        """The equation of motion near a motion.

        Args:
            position: [rad], shape (instants, joints).
            velocity: [rad/s], the same shape.
            acceleration: [rad/s^2], the same shape.
            every: Stiffness and damping, which matter only away from the motion, are evaluated at
                each `every`-th instant and interpolated.
        """
        branches, count = self.branches, len(position)
        mass, bias = self._evaluate(position, velocity)
        some = np.unique(np.append(np.arange(0, count, every), count - 1))
        slopes = self._slopes(position[some], velocity[some], acceleration[some])
        stiffness, damping = (_interpolated(some, values, count) for values in slopes)
        linear = _torque(stiffness, position[:, branches]) + _torque(damping, velocity[:, branches])
        return LinearLegs(mass=mass, offset=bias - linear, stiffness=stiffness, damping=damping)

    def _slopes(
        self, position: Floats, velocity: Floats, acceleration: Floats
    ) -> tuple[Floats, Floats]:
        """Stiffness and damping."""
        mass, bias = self._evaluate(position, velocity)
        branches = self.branches
        force = _torque(mass, acceleration[:, branches]) + bias
        stiffness, damping = np.zeros((2, *mass.shape))
        for joint in range(
            branches.shape[1]
        ):  # the same joint of all branches at once: they do not feel each other
            step = np.zeros_like(position)
            step[:, branches[:, joint]] = SLOPE
            moved_mass, moved_bias = self._evaluate(position + step, velocity)
            stiffness[..., joint] = (
                _torque(moved_mass, acceleration[:, branches]) + moved_bias - force
            ) / SLOPE
            _, faster = self._evaluate(position, velocity + step)
            _, slower = self._evaluate(position, velocity - step)
            damping[..., joint] = (faster - slower) / (2.0 * SLOPE)
        return stiffness, damping

    def weight(self, position: Floats) -> Floats:
        """Torques that hold the joints still [Nm], both of shape (instants, joints)."""
        _, bias = self._evaluate(position, np.zeros_like(position))
        torque = np.empty_like(position)
        torque[:, self.branches] = bias
        return torque

    def rolling(self, position: Floats, velocity: Floats, acceleration: Floats) -> RollingBase:
        """Returns what a base feels that may roll about its x axis while the joints move.

        Arguments as of `along`.

        Raises:
            ModelError: the robot has no base that could move, or more joints than are given.
        """
        model = _held_model(*self._source, rolls=True)
        if model.nv != len(self._dof) + 1 or model.njnt == self._model.njnt:
            raise ModelError("it is not known how all that hangs from the base moves")
        count, roll = len(position), _dof(model, ROLL)
        dof = np.array(
            [_dof(model, self._model.joint(int(self._model.dof_jntid[d])).name) for d in self._dof]
        )
        batch = Batch(model, nsim=min(CHUNK, count), nthread=1)
        qpos, qvel, bias, entries = (
            batch.bind(name) for name in ("qpos", "qvel", "qfrc_bias", "M")
        )
        index = _mass_entries(model)
        of_one_chain = (index > 0) | (np.arange(model.nv) + np.arange(model.nv)[:, None] == 0)
        force = np.empty((3, count, model.nv))
        mass = np.empty((count, model.nv))
        for start in range(0, count, CHUNK):
            part = slice(start, min(start + CHUNK, count))
            own = part.stop - part.start
            moved = np.zeros((own, model.nv))
            moved[:, dof] = acceleration[part]
            qpos[:own, dof], qvel[:own, dof] = position[part], velocity[part]
            for step, (angle, rate) in zip(
                force, ((0.0, 0.0), (SLOPE, 0.0), (0.0, SLOPE)), strict=True
            ):
                qpos[:own, roll], qvel[:own, roll] = angle, rate
                batch.forward(np.arange(own))
                step[part] = _torque(of_one_chain * entries[:own][:, index], moved) + bias[:own]
            mass[part] = entries[:own][:, index[roll]]
        slopes = np.stack([*(force[1:] - force[0]) / SLOPE, mass], axis=-1)
        return RollingBase(
            moment=force[0][:, roll],
            on_base=slopes[:, roll],
            on_joints=slopes[:, dof[self.branches]],
        )

    def _evaluate(self, position: Floats, velocity: Floats) -> tuple[Floats, Floats]:
        """Mass matrices, shape (instants, branches, joints, joints),
        and bias forces with claimed damping.
        """
        model = self._model
        if self._batch is None:
            self._batch = Batch(model, nsim=CHUNK, nthread=1)
        batch = self._batch
        qpos, qvel = batch.bind("qpos"), batch.bind("qvel")
        qfrc_bias, entries = batch.bind("qfrc_bias"), batch.bind("M")
        index = _mass_entries(model)[np.ix_(self._dof, self._dof)]
        rows, columns = self.branches[:, :, None], self.branches[:, None, :]
        mass = np.empty((len(position), *self.branches.shape, self.branches.shape[1]))
        bias = np.empty((len(position), *self.branches.shape))
        where = model.jnt_qposadr[model.dof_jntid[self._dof]]
        for start in range(0, len(position), CHUNK):
            part = slice(start, min(start + CHUNK, len(position)))
            count = part.stop - part.start
            qpos[:count, where], qvel[:count, self._dof] = position[part], velocity[part]
            batch.forward(np.arange(count))
            mass[part] = entries[:count][:, index[rows, columns]]
            passive = model.dof_damping[self._dof] * velocity[part]
            bias[part] = (qfrc_bias[:count, self._dof] + passive)[:, self.branches]
        return mass, bias


def _interpolated(known: NDArray[np.integer], values: Floats, count: int) -> Floats:
    """Values at all of `count` instants from those at some, linear in between."""
    if len(known) == count:
        return values
    at = np.arange(count)
    right = np.clip(np.searchsorted(known, at, side="right"), 1, len(known) - 1)
    weight = (at - known[right - 1]) / (known[right] - known[right - 1])
    weight = weight.reshape(-1, *(1,) * (values.ndim - 1))
    return np.asarray((1.0 - weight) * values[right - 1] + weight * values[right])


def _torque(matrix: Floats, vector: Floats) -> Floats:
    return np.asarray((matrix @ vector[..., None])[..., 0])


def _held_model(
    robot: Robot | Path, base_quaternion: Floats, *, rolls: bool = False
) -> mujoco.MjModel:
    """Compiles the model without free joint, or with one that `rolls` in its place.

    Nothing touches anything.
    """
    if isinstance(robot, Robot):
        spec = robot_model.build_spec(robot, flat.make())
    else:
        try:
            spec = mujoco.MjSpec.from_file(str(robot))
        except (ValueError, OSError) as error:
            raise ModelError(f"cannot read the robot's model {robot}: {error}") from error
    spec.option.disableflags |= int(
        mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_SENSOR
    )
    for joint in list(spec.joints):
        if joint.type == mujoco.mjtJoint.mjJNT_FREE:
            joint.parent.quat = base_quaternion
            if rolls:
                joint.parent.add_joint(
                    name=ROLL, type=mujoco.mjtJoint.mjJNT_HINGE, axis=(1.0, 0.0, 0.0)
                )
            spec.delete(joint)
    for key in list(spec.keys):  # of a robot that is not held
        spec.delete(key)
    try:
        return spec.compile()
    except ValueError as error:
        name = robot.name if isinstance(robot, Robot) else robot
        raise ModelError(f"the robot's model {name} cannot be held: {error}") from error


def _dof(model: mujoco.MjModel, name: str) -> int:
    known = [model.joint(i).name for i in range(model.njnt)]
    for candidate in (name, f"{name}_joint"):
        if candidate in known:
            return int(model.joint(candidate).dofadr[0])
    raise ModelError(f"the robot's model has no joint '{name}': {nearest_hint(name, known)}")


def _branches(model: mujoco.MjModel, dof: NDArray[np.integer]) -> NDArray[np.int64]:
    trees = model.dof_treeid[dof]
    groups = [np.flatnonzero(trees == tree) for tree in dict.fromkeys(trees.tolist())]
    if len({len(group) for group in groups}) != 1:
        raise ModelError(
            f"the robot's branches have {[len(g) for g in groups]} joints: all must have the same "
            "number"
        )
    # joints nearer to the base come first among the degrees of freedom
    return np.array([group[np.argsort(dof[group])] for group in groups])


def _mass_entries(model: mujoco.MjModel) -> NDArray[np.int64]:
    """Where an entry lies in the engine's sparse mass matrix, shape (nv, nv);
    0 for joints of different chains.
    """
    index = np.zeros((model.nv, model.nv), dtype=np.int64)
    for row in range(model.nv):
        for k in range(model.M_rownnz[row]):
            entry = model.M_rowadr[row] + k
            column = model.M_colind[entry]
            index[row, column] = index[column, row] = entry
    return index
