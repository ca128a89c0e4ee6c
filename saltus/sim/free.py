"""Many copies of one robot on one ground, put into given states and driven by given torques: short replays of a log."""

from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco.batch import Batch

from saltus.constants import PHYSICS_DT
from saltus.effects.body import BodyModel
from saltus.robots.robot import LEGS, Robot
from saltus.sim import scene
from saltus.sim.state import Floats
from saltus.terrain import flat
from saltus.terrain.boxes import Boxes

GROUND_SIZE = 100.0  # half edge length of flat ground [m]: wherever motion capture has its origin
OWN_GROUND = 1e-3  # boxes of which one has its top below this [m] bring their own ground


@dataclass(frozen=True, kw_only=True)
class Solver:
    """How contacts and time are computed; the defaults are the scene's own."""

    impratio: float = scene.CONTACT_IMPRATIO
    """Ratio of frictional to normal stiffness."""
    impedance: tuple[float, float] = scene.CONTACT_SOLIMP[:2]
    """Of contacts, at the first touch and deep down."""
    is_pyramidal: bool = False
    """Whether the cone of friction has four sides."""
    substeps: int = 1
    """Steps of the engine in one of `PHYSICS_DT`."""


OWN_SOLVER = Solver()


class FreeRobots:
    """`count` robots without drives, on the same boxes; only trunk, knees and feet are solid.

    Args:
        robot: Which one.
        count: Number of robots.
        boxes: On flat ground at height 0, or, where one of them is no higher than that, in its place; without leading
            dimension, and there may be none.
        solver: Of contacts.
        threads: Of the physics; 0 is one for each core.

    Attributes:
        qpos: Base position, base quaternion (w, x, y, z), joints. Live, shape (count, 19).
        qvel: Base velocity (world frame), angular velocity (base frame), joint velocities. Live, shape (count, 18).
    """

    def __init__(
        self, robot: Robot, count: int, boxes: Boxes, *, solver: Solver = OWN_SOLVER, threads: int = 1
    ) -> None:
        self.count = count
        self._model = _compiled(robot, boxes, solver)
        self._substeps = solver.substeps
        self._batch = Batch(self._model, nsim=count, nthread=threads)
        bind, expand = self._batch.bind, self._batch.expand
        self.qpos, self.qvel, self._ctrl = bind("qpos"), bind("qvel"), bind("ctrl")
        self._warmstart, self._sensors = bind("qacc_warmstart"), bind("sensordata")
        self._geom_friction, self._geom_solref = expand("geom_friction"), expand("geom_solref")
        self._geom_solimp, self._impratio = expand("geom_solimp"), expand("opt.impratio")
        self._body_mass, self._body_inertia = expand("body_mass"), expand("body_inertia")
        self._body_ipos, self._body_pos = expand("body_ipos"), expand("body_pos")
        self._damping, self._frictionloss = expand("dof_damping"), expand("dof_frictionloss")
        self._geoms = np.flatnonzero(self._model.geom_group == scene.ROBOT_GROUP)
        self._trunk, self._payload = self._model.body(scene.TRUNK).id, self._model.body(scene.PAYLOAD).id

    def set_contacts(self, impratio: Floats, impedance: Floats) -> None:
        """Gives the first robots contacts other than the solver's, before `set_bodies`; shapes (n,) and (n, 2)."""
        n = len(impratio)
        self._impratio[:n] = impratio.reshape(n, *self._impratio.shape[1:])
        self._geom_solimp[:n, self._geoms, :2] = impedance[:, None]

    def set_payload_position(self, position: Floats) -> None:
        """Puts the payload of every robot there, before `set_bodies` [m], base frame, shape (3,)."""
        self._body_pos[:, self._payload] = position

    def set_bodies(self, body: BodyModel) -> None:
        """Gives the first robots their bodies and their ground; arrays of shape (n, ...)."""
        n, model = len(body.payload_kg), self._model
        self._geom_friction[:n, self._geoms, 0] = body.friction[:, None]
        self._geom_solref[:n, self._geoms, 0] = body.contact_time_constant[:, None]
        self._body_mass[:n, self._payload] = body.payload_kg
        self._body_inertia[:n, self._payload] = body.payload_kg[:, None] * scene.payload_inertia(1.0)
        self._body_ipos[:n, self._trunk] = model.body_ipos[self._trunk] + body.com_shift
        self._body_inertia[:n, self._trunk] = body.inertia_scale[:, None] * model.body_inertia[self._trunk]
        self._batch.set_const(np.arange(n))

    def set_friction(self, viscous: Floats, coulomb: Floats) -> None:
        """Gives the joints of the first robots friction [Nm s/rad], [Nm], shapes (n, 1) or (n, 12)."""
        self._damping[: len(viscous), 6:] = viscous
        self._frictionloss[: len(coulomb), 6:] = coulomb

    def place(self, qpos: Floats, qvel: Floats) -> None:
        """Puts the first robots into states, shapes (n, 19) and (n, 18)."""
        n = len(qpos)
        self.qpos[:n], self.qvel[:n], self._warmstart[:n] = qpos, qvel, 0.0

    def step(self, torque: Floats) -> None:
        """Advances the first robots by `PHYSICS_DT` under joint torques [Nm], shape (n, 12)."""
        self._ctrl[: len(torque)] = torque
        self._batch.step(np.arange(len(torque)), nstep=self._substeps)

    @property
    def foot_force(self) -> Floats:
        """Of the ground on each foot, mean over the last step, world frame [N], shape (count, 4, 3)."""
        return -self._sensors[:, scene.FOOT_FORCE].reshape(-1, 4, 3)


def _compiled(robot: Robot, boxes: Boxes, solver: Solver) -> mujoco.MjModel:
    # with a payload, so that what the engine derives from masses exists for every robot
    spec = scene.build_spec(robot, flat.make(), payload_kg=1.0)
    ground = next(geom for geom in spec.geoms if geom.group == scene.TERRAIN_GROUP)
    scene.add_boxes(spec, boxes, "box_{}")
    if (boxes.center[:, 2] + boxes.extent[:, 2] < OWN_GROUND).any():
        spec.delete(ground)
    else:
        ground.size[:2] = GROUND_SIZE
    for sensor in list(spec.sensors):
        if not sensor.name.endswith("_force"):
            spec.delete(sensor)
    solid = (scene.TRUNK, *(f"{leg}_{link}" for leg in LEGS for link in ("calf", "foot")))
    for geom in spec.geoms:
        if geom.group == scene.ROBOT_GROUP and geom.name not in solid:
            geom.contype = geom.conaffinity = 0
        geom.solimp[:2] = solver.impedance if geom.group == scene.ROBOT_GROUP else geom.solimp[:2]
    spec.option.impratio = solver.impratio
    spec.option.timestep = PHYSICS_DT / solver.substeps
    if solver.is_pyramidal:
        spec.option.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    return spec.compile()
