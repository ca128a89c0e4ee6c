"""A robot along a measured motion: the forces that its bodies need for it,
and where it touches the ground.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.effects.body import BodyModel
from saltus.robots.robot import JOINTS, LEGS, Robot
from saltus.sim import free_robots
from saltus.sim.model_layout import ModelLayout
from saltus.terrain.boxes import Boxes

CLEAR_M = 0.005
"""A foot that is nearer to the ground may touch it: poses between two measured ones are off by a
millimetre or two."""
STOP_RAD = 0.01
"""A joint that is nearer to its stop may touch it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredMotion:
    """States at n instants, and how velocities change from there on."""

    position: Floats
    """Position of base, its quaternion and joints, shape (n, 19)."""
    velocity: Floats
    """Velocity of the base in the world, its rates in its own frame, joints, shape (n, 18)."""
    acceleration: Floats
    """Shape (n, 18)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredContact:
    """How a robot stands at n instants."""

    jacobian: Floats
    """Velocity of the point at which each foot would touch, by all velocities, shape (n, 4, 3,
    18)."""
    foot: NDArray[np.bool_]
    """Feet that may touch the ground, shape (n, 4)."""
    elsewhere: NDArray[np.bool_]
    """True where anything but a foot touches, or a joint its stop, shape (n,)."""


class MeasuredRobot:
    """One robot that is moved, not simulated.

    Args:
        robot: Which one.
        boxes: Of the ground, as `FreeRobots` takes them.
        payload_position: Of what is on top of the trunk [m], base frame, shape (3,); None for the
            simulator's own.
    """

    def __init__(
        self, robot: Robot, boxes: Boxes, payload_position: Sequence[float] | None = None
    ) -> None:
        spec = free_robots.spec_on(robot, boxes)
        self._model = spec.compile()
        self._layout = ModelLayout(robot, self._model)
        if payload_position is not None:
            place = np.asarray(payload_position, dtype=np.float64)
            self._layout.write_payload_position(
                lambda name: getattr(self._model, name), place, robots=()
            )
        self._feet = [self._model.geom(f"{leg}_foot").id for leg in LEGS]
        self._model.geom_margin[self._feet] = CLEAR_M
        self._radius = robot.foot_radius
        joints = [self._model.joint(name) for name in JOINTS]
        self._low, self._high = np.array(
            [j.range if j.limited else (-np.inf, np.inf) for j in joints]
        ).T
        self._data = mujoco.MjData(self._model)

    def forces(self, motion: MeasuredMotion, body: BodyModel) -> Floats:
        """Forces of this motion: force [N] and moment [Nm] on the base,
        torques of joints, shape (n, 18).
        """
        self._layout.write_bodies(lambda name: getattr(self._model, name), body, robots=())
        mujoco.mj_setConst(self._model, mujoco.MjData(self._model))
        data, found = self._data, np.empty_like(motion.velocity)
        for k, state in enumerate(
            zip(motion.position, motion.velocity, motion.acceleration, strict=True)
        ):
            data.qpos[:], data.qvel[:], data.qacc[:] = state
            mujoco.mj_inverse(self._model, data)
            found[k] = data.qfrc_inverse + data.qfrc_constraint
        return found

    def touch(self, position: Floats) -> MeasuredContact:
        """Where a robot with these positions touches the ground, shape (n, 19)."""
        model, data, count = self._model, self._data, len(position)
        jacobian, foot = (
            np.empty((count, len(LEGS), 3, model.nv)),
            np.zeros((count, len(LEGS)), dtype=bool),
        )
        elsewhere = np.zeros(count, dtype=bool)
        for k, qpos in enumerate(position):
            data.qpos[:] = qpos
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_collision(model, data)
            points = data.geom_xpos[self._feet] - np.array([0.0, 0.0, self._radius])
            touching = data.contact.geom
            for i, geom in enumerate(self._feet):
                own = np.flatnonzero(np.any(touching == geom, axis=1))
                if len(own):
                    foot[k, i] = True
                    points[i] = data.contact.pos[own[np.argmin(data.contact.dist[own])]]
                mujoco.mj_jac(model, data, jacobian[k, i], None, points[i], model.geom_bodyid[geom])
            angle = qpos[-len(JOINTS) :]
            at_stop = np.any((angle < self._low + STOP_RAD) | (angle > self._high - STOP_RAD))
            elsewhere[k] = at_stop or not np.isin(touching, self._feet).any(axis=1).all()
        return MeasuredContact(jacobian=jacobian, foot=foot, elsewhere=elsewhere)
