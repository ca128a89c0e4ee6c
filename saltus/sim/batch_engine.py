"""The physics of training on the cores of a CPU."""

import mujoco
import numpy as np
from mujoco.batch import Batch

from saltus.arrays import Array
from saltus.robots.robot import Robot
from saltus.sim import scene
from saltus.sim.engine import TOUCHING, Engine, ModelIndices, build_spec
from saltus.terrain.boxes import Boxes


class BatchEngine(Engine):
    """Many robots in MuJoCo itself; numpy arrays of float64.

    Args:
        robot: Which one.
        count: Number of robots.
        boxes: Terrain boxes of each.
        threads: Of the physics; 0 is one for each core.
    """

    def __init__(self, robot: Robot, count: int, boxes: int, *, threads: int = 0) -> None:
        self.robot, self.count, self.boxes = robot, count, boxes
        self.model = _with_contact_sensors(robot, boxes)
        self._where = ModelIndices(self.model)
        self._batch = Batch(self.model, nsim=count, nthread=threads)
        bind, expand = self._batch.bind, self._batch.expand
        self.qpos, self.qvel, self.ctrl = bind("qpos"), bind("qvel"), bind("ctrl")
        self.warmstart, self._qacc, self._sensors = bind("qacc_warmstart"), bind("qacc"), bind("sensordata")
        self.qacc = self._qacc.copy()  # the engine's own array cannot be shared with torch: it must not be written
        self.trunk_wrench = bind("xfrc_applied").reshape(count, self.model.nbody, 6)[:, self._where.trunk]
        self._geom_pos, self._geom_size = expand("geom_pos"), expand("geom_size")
        self._geom_rbound, self._geom_friction = expand("geom_rbound"), expand("geom_friction")
        self._geom_aabb = expand("geom_aabb").reshape(count, self.model.ngeom, 6)
        self._body_mass, self._body_inertia = expand("body_mass"), expand("body_inertia")
        self._body_ipos = expand("body_ipos")

    def step(self) -> None:
        """Advances all robots by `PHYSICS_DT`."""
        self._batch.step()
        self.qacc[:] = self._qacc

    def touching(self) -> Array:
        """Which shapes touched the terrain, shape (count, 16)."""
        return self._sensors > 0.0

    def crowded(self) -> Array:
        """No robot, shape (count,): the engine makes room as it is needed."""
        return np.zeros(self.count, dtype=np.bool_)

    def set_terrain(self, boxes: Boxes) -> None:
        """Puts boxes under all robots."""
        half_size, where = np.asarray(boxes.half_size), self._where.terrain
        self._geom_pos[:, where] = np.asarray(boxes.center)
        self._geom_size[:, where] = half_size
        self._geom_rbound[:, where] = np.linalg.norm(half_size, axis=-1)
        self._geom_aabb[:, where, 3:] = half_size
        if boxes.turn is not None or self._batch.expanded("geom_quat") is not None:
            self._batch.expand("geom_quat")[:, where] = np.asarray(boxes.quaternion)
            # a box that was compiled level would keep the axes of the world
            self._batch.expand("geom_sameframe")[:, where] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE

    def set_bodies(self, friction: Array, payload_kg: Array, com_shift: Array) -> None:
        """Gives all robots their soles, payloads and trunks."""
        mass = np.asarray(payload_kg)
        self._geom_friction[:, self._where.robot, 0] = np.asarray(friction)[:, None]
        self._body_mass[:, self._where.payload] = mass
        self._body_inertia[:, self._where.payload] = mass[:, None] * scene.payload_inertia(1.0)
        self._body_ipos[:, self._where.trunk] = self._where.trunk_com + np.asarray(com_shift)

    def set_joints(self, friction: Array, damping: Array, armature: Array) -> None:
        """Gives all joints their friction and inertia."""
        expand = self._batch.expand
        expand("dof_frictionloss")[:, 6:] = np.asarray(friction)
        expand("dof_damping")[:, 6:] = np.asarray(damping)
        expand("dof_armature")[:, 6:] = self.robot.armature + np.asarray(armature)


def _with_contact_sensors(robot: Robot, boxes: int) -> mujoco.MjModel:
    spec = build_spec(robot, boxes)
    # The boxes change; the middle phase looks boxes that do not move up in a tree made from the first ones.
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_MIDPHASE
    found = 1 << int(mujoco.mjtConDataField.mjCONDATA_FOUND)
    for name in TOUCHING:
        sensor = spec.add_sensor(name=f"{name}_touching", type=mujoco.mjtSensor.mjSENS_CONTACT)
        sensor.objtype, sensor.objname = mujoco.mjtObj.mjOBJ_GEOM, name
        sensor.intprm[:3] = (found, 0, 1)
    return spec.compile()
