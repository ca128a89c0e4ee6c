"""Where robot and terrain lie in the arrays of a compiled model,
and how robots of an engine get others.

One model, a batch in MuJoCo and one in mujoco_warp have the same fields, in numpy or torch, without
or with a leading dimension of robots; what differs from robot to robot is written to them by the
same lines.
"""

from collections.abc import Callable
from typing import TypeAlias

import mujoco
import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Array, Constant, namespace
from saltus.effects.body import BodyModel
from saltus.robots.robot import Robot
from saltus.sim import robot_model
from saltus.terrain.boxes import Boxes

FieldReader = Callable[[str], Array]
"""A live array by its name in `mujoco.MjModel`."""
Rows: TypeAlias = NDArray[np.integer | np.bool_] | slice
Robots: TypeAlias = tuple[()] | tuple[Rows]
"""Which robots: an index into the leading dimension of fields; empty where they have none."""

ALL = slice(None)
EVERYONE: Robots = (ALL,)
BASE_DOF = 6


class ModelLayout:
    """Places in the arrays of a compiled model of `robot_model.build_spec`."""

    def __init__(self, robot: Robot, model: mujoco.MjModel) -> None:
        self.trunk, self.payload = (
            model.body(robot_model.TRUNK).id,
            model.body(robot_model.PAYLOAD).id,
        )
        self.terrain, self.robot = (
            _span(model, group) for group in (robot_model.TERRAIN_GROUP, robot_model.ROBOT_GROUP)
        )
        # Where no one shifted its centre
        own = mujoco.MjSpec.from_string(robot.mjcf).body(robot_model.TRUNK)
        self._trunk_com = Constant(own.ipos.copy())
        self._trunk_inertia = Constant(model.body_inertia[self.trunk].copy())
        self._payload_inertia = Constant(robot_model.payload_inertia(1.0))
        self._armature = Constant(model.dof_armature[BASE_DOF:].copy())

    def write_bodies(self, field: FieldReader, body: BodyModel, robots: Robots = EVERYONE) -> None:
        """Gives robots their bodies and their ground.

        Arrays of shape (n, ...), or without n where there is none.
        """
        mass, scale, shift = body.payload_kg[..., None], _column(body.inertia_scale), body.com_shift
        inertia = field("body_inertia")
        friction, impedance = field("geom_friction"), field("geom_solimp")
        for place, value in enumerate((body.friction, body.torsion, body.rolling)):
            friction[(*robots, self.robot, place)] = _column(value)
        field("geom_solref")[(*robots, self.robot, 0)] = _column(body.contact_time_constant)
        impedance[(*robots, self.robot, 0)] = _column(body.touch_impedance)
        impedance[(*robots, self.robot, 2)] = _column(body.impedance_depth)
        field("body_mass")[(*robots, self.payload)] = body.payload_kg
        inertia[(*robots, self.payload)] = mass * self._payload_inertia.like(mass)
        inertia[(*robots, self.trunk)] = scale * self._trunk_inertia.like(mass)
        field("body_ipos")[(*robots, self.trunk)] = self._trunk_com.like(shift) + shift

    def write_payload_position(
        self, field: FieldReader, position: Array, robots: Robots = EVERYONE
    ) -> None:
        """Puts the centre of mass of what is on top of the trunk there [m],
        base frame, shape (3,).
        """
        field("body_pos")[(*robots, self.payload)] = position

    def write_joints(
        self,
        field: FieldReader,
        friction: Array,
        damping: Array,
        armature: Array | float,
        robots: Robots = EVERYONE,
    ) -> None:
        """Gives joints dry friction [Nm], viscous friction [Nm s/rad]
        and inertia beyond the model's [kg m^2].

        Arrays have the shape (n or 1, 12), or (12,) where there is no n.
        """
        joints = (*robots, slice(BASE_DOF, None))
        field("dof_frictionloss")[joints] = friction
        field("dof_damping")[joints] = damping
        field("dof_armature")[joints] = self._armature.like(friction) + armature

    def write_boxes(self, field: FieldReader, boxes: Boxes, robots: Robots = EVERYONE) -> None:
        """Puts boxes under robots, but for the angles at which they stand.

        Arrays of shape (n, boxes, ...).

        `field` gives `geom_aabb` with the shape (n, geoms, 2, 3): centre and half size.
        """
        where = (*robots, self.terrain)
        field("geom_pos")[where] = boxes.center
        field("geom_size")[where] = boxes.half_size
        field("geom_aabb")[(*where, 1)] = boxes.half_size
        field("geom_rbound")[where] = namespace(boxes.half_size).linalg.vector_norm(
            boxes.half_size, axis=-1
        )


def _column(value: Array | float) -> Array | float:
    return value if isinstance(value, float) else value[..., None]


def _span(model: mujoco.MjModel, group: int) -> slice:
    geoms = np.flatnonzero(model.geom_group == group)
    return slice(int(geoms[0]), int(geoms[-1]) + 1)
