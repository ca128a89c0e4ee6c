"""Many copies of one robot on one ground, put into given states and driven by given torques:
short replays of a log.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from saltus.arrays import Floats
from saltus.constants import PHYSICS_DT
from saltus.robots.robot import LEGS, Robot
from saltus.sim import robot_model
from saltus.sim.mujoco_batch import MujocoBatch
from saltus.terrain import flat
from saltus.terrain.boxes import Boxes

GROUND_SIZE = 100.0  # half edge length of flat ground [m]: wherever motion capture has its origin
OWN_GROUND = 1e-3  # boxes of which one has its top below this [m] bring their own ground


@dataclass(frozen=True, kw_only=True)
class ContactSolver:
    """How contacts and time of simulated robots are computed; the defaults are the scene's own."""

    impratio: float = robot_model.CONTACT_IMPRATIO
    """Ratio of frictional to normal stiffness."""
    impedance: tuple[float, float] = robot_model.CONTACT_SOLIMP[:2]
    """Impedance of contacts, at the first touch and deep down."""
    is_pyramidal: bool = False
    """True where the cone of friction has four sides."""
    dimensions: int = 3
    """Dimensions of contacts; 6 with friction against turning and rolling."""
    substeps: int = 1
    """Steps of the engine in one of `PHYSICS_DT`."""


OWN_SOLVER = ContactSolver()


class FreeRobots(MujocoBatch):
    """`count` robots without drives, on the same boxes; only trunk, knees and feet are solid.

    The boxes stand on flat ground at height 0, or, where one of them is no higher than that, in its
    place. They have no leading dimension, and there may be none.
    """

    def __init__(
        self,
        robot: Robot,
        count: int,
        boxes: Boxes,
        *,
        solver: ContactSolver = OWN_SOLVER,
        threads: int = 1,
    ) -> None:
        super().__init__(robot, _compiled(robot, boxes, solver), count, threads=threads)
        self._substeps = solver.substeps
        self._sensors = self.batch.bind("sensordata")

    def set_contacts(self, impratio: Floats, impedance: Floats) -> None:
        """Gives the first robots contacts other than the solver's, after `set_bodies`.

        Shapes (n,) and (n, 2).
        """
        n = len(impratio)
        ratios = self.field("opt.impratio")
        ratios[:n] = impratio.reshape(n, *ratios.shape[1:])
        self.field("geom_solimp")[:n, self.layout.robot, :2] = impedance[:, None]

    def set_payload_position(self, position: Floats) -> None:
        """Puts the payload's mass of every robot there,
        before `set_bodies` [m], base frame, shape (3,).
        """
        self.layout.write_payload_position(self.field, position)

    def place(self, qpos: Floats, qvel: Floats) -> None:
        """Puts the first robots into states, shapes (n, 19) and (n, 18)."""
        n = len(qpos)
        self.qpos[:n], self.qvel[:n], self.warmstart[:n] = qpos, qvel, 0.0

    def step(self, torque: Floats) -> None:
        """Advances the first robots by `PHYSICS_DT` under joint torques [Nm], shape (n, 12)."""
        self.ctrl[: len(torque)] = torque
        self.batch.step(np.arange(len(torque)), nstep=self._substeps)

    @property
    def foot_force(self) -> Floats:
        """Force of the ground on each foot, mean over the last step,
        world frame [N], shape (count, 4, 3).
        """
        return -self._sensors[:, robot_model.FOOT_FORCE].reshape(-1, 4, 3)


def spec_on(robot: Robot, boxes: Boxes, dimensions: int = 3) -> mujoco.MjSpec:
    """Describes a robot with a payload, on these boxes as `FreeRobots` takes them."""
    # with a payload, so that what the engine derives from masses exists for every robot
    spec = robot_model.build_spec(robot, flat.make(), payload_kg=1.0, dimensions=dimensions)
    ground = next(geom for geom in spec.geoms if geom.group == robot_model.TERRAIN_GROUP)
    robot_model.add_boxes(spec, boxes, "box_{}")
    if (boxes.center[:, 2] + boxes.extent[:, 2] < OWN_GROUND).any():
        spec.delete(ground)
    else:
        ground.size[:2] = GROUND_SIZE
    return spec


def _compiled(robot: Robot, boxes: Boxes, solver: ContactSolver) -> mujoco.MjModel:
    spec = spec_on(robot, boxes, solver.dimensions)
    for sensor in list(spec.sensors):
        if not sensor.name.endswith("_force"):
            spec.delete(sensor)
    solid = (robot_model.TRUNK, *(f"{leg}_{link}" for leg in LEGS for link in ("calf", "foot")))
    for geom in spec.geoms:
        if geom.group == robot_model.ROBOT_GROUP and geom.name not in solid:
            geom.contype = geom.conaffinity = 0
        geom.solimp[:2] = (
            solver.impedance if geom.group == robot_model.ROBOT_GROUP else geom.solimp[:2]
        )
    spec.option.impratio = solver.impratio
    spec.option.timestep = PHYSICS_DT / solver.substeps
    if solver.is_pyramidal:
        spec.option.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    return spec.compile()
