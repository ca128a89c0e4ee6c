"""The physics of training on the cores of a CPU: MuJoCo's batch as a `saltus.sim.engine.Engine`."""

import mujoco
import numpy as np

from saltus.arrays import Array
from saltus.robots.robot import Robot
from saltus.sim.engine import TOUCHING, Engine, build_engine_spec
from saltus.sim.mujoco_batch import MujocoBatch


class CpuEngine(MujocoBatch, Engine):
    """Many robots in MuJoCo itself, each on boxes of its own; numpy arrays of float64."""

    def __init__(
        self, robot: Robot, count: int, boxes: int, *, dimensions: int = 3, threads: int = 0
    ) -> None:
        super().__init__(
            robot, _with_contact_sensors(robot, boxes, dimensions), count, threads=threads
        )
        self.boxes, self.dimensions = boxes, dimensions
        self._qacc, self._sensors = self.batch.bind("qacc"), self.batch.bind("sensordata")
        # The engine's own array cannot be shared with torch: it must not be written
        self.qacc = self._qacc.copy()

    def step(self) -> None:
        """Advances all robots by `PHYSICS_DT`."""
        self.batch.step()
        self.qacc[:] = self._qacc

    def touching(self) -> Array:
        """Which shapes touched the terrain, shape (count, 16)."""
        return self._sensors > 0.0

    def crowded(self) -> Array:
        """Robots with more contacts than there is room for, bool, shape (count,):
        none, as this engine makes room as needed.
        """
        return np.zeros(self.count, dtype=np.bool_)


def _with_contact_sensors(robot: Robot, boxes: int, dimensions: int) -> mujoco.MjModel:
    spec = build_engine_spec(robot, boxes, dimensions)
    # The boxes change; the middle phase looks boxes that do not move up in a tree made from the
    # first ones.
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_MIDPHASE
    found = 1 << int(mujoco.mjtConDataField.mjCONDATA_FOUND)
    for name in TOUCHING:
        sensor = spec.add_sensor(name=f"{name}_touching", type=mujoco.mjtSensor.mjSENS_CONTACT)
        sensor.objtype, sensor.objname = mujoco.mjtObj.mjOBJ_GEOM, name
        sensor.intprm[:3] = (found, 0, 1)
    return spec.compile()
