"""The physics of many robots for training: live arrays in place of objects, and one step for all.

`CpuEngine` runs on the cores of a CPU and `saltus.sim.warp_engine.WarpEngine` on a GPU, behind the
same few arrays. Both simulate the robot of `saltus.sim.robot_model` on boxes that differ from robot
to robot, with two simplifications that training can afford: the trunk is not solid (who simulates
looks whether the trunk is below the terrain, and ends the episode there), and what the engine
derives from masses, the softness of contacts, stays that of a medium payload.
"""

from abc import ABC, abstractmethod

import mujoco

from saltus.arrays import Array
from saltus.effects.body import BodyModel
from saltus.robots.robot import LEGS, Robot
from saltus.sim import robot_model
from saltus.terrain import flat
from saltus.terrain.boxes import Boxes

MEDIUM_PAYLOAD_KG = 0.75  # middle of what trials draw

TOUCHING = tuple(f"{leg}_{link}" for link in ("foot", "thigh", "calf", "hip") for leg in LEGS)
"""The shapes whose contacts an engine reports, in their order."""


class Engine(ABC):
    """Anything that simulates `count` robots that know nothing of each other.

    The arrays are alive: the next step changes those that are results, and reads those that are
    inputs.
    """

    robot: Robot
    count: int
    boxes: int
    """Terrain boxes of each robot."""
    dimensions: int
    """Dimensions of contacts: 3, or 6 with friction against turning and rolling."""
    qpos: Array
    """Base position, base quaternion (w, x, y, z), joints; world frame. Shape (count, 19).

    May be written.
    """
    qvel: Array
    """Base velocity (world frame), angular velocity (base frame), joint velocities. Shape (count,
    18). May be written."""
    qacc: Array
    """Acceleration over the last step, shape (count, 18)."""
    warmstart: Array
    """Where the contact solver starts from, shape (count, 18): 0 for a robot that was put somewhere
    else."""
    ctrl: Array
    """Joint torques [Nm], shape (count, 12). Input."""
    trunk_wrench: Array
    """Force and torque on the trunk, world frame [N, Nm], shape (count, 6). Input."""

    @abstractmethod
    def step(self) -> None:
        """Advances all robots by `PHYSICS_DT`."""

    @abstractmethod
    def touching(self) -> Array:
        """Which shapes touched the terrain at the start of the last step:
        shape (count, 16), order of `TOUCHING`.
        """

    @abstractmethod
    def crowded(self) -> Array:
        """Which robots had contacts that found no room since the last call,
        and were not simulated: shape (count,).
        """

    @abstractmethod
    def set_terrain(self, boxes: Boxes) -> None:
        """Puts boxes under all robots; arrays of shape (count, boxes, ...)."""

    @abstractmethod
    def set_bodies(self, body: BodyModel) -> None:
        """Gives all robots their bodies and their ground; arrays of shape (count, ...)."""

    @abstractmethod
    def set_joints(self, friction: Array, damping: Array, armature: Array) -> None:
        """Dry friction [Nm], viscous friction [Nm s/rad] and inertia beyond the model's [kg m^2],
        (count or 1, 12).
        """


def build_engine_spec(robot: Robot, boxes: int, dimensions: int) -> mujoco.MjSpec:
    """The robot of `robot_model.build_spec` with `boxes` terrain boxes,
    a trunk that is not solid and no force sensors.
    """
    spec = robot_model.build_spec(
        robot, flat.make(), payload_kg=MEDIUM_PAYLOAD_KG, columns=boxes, dimensions=dimensions
    )
    for sensor in list(spec.sensors):
        spec.delete(sensor)
    for geom in spec.geoms:
        if geom.name == robot_model.TRUNK:
            geom.contype = geom.conaffinity = 0
    return spec
