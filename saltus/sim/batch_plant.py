"""The plant of a run for many robots at once on the cores of a CPU, with drives and sensors.

Each has its own terrain, friction and payload.
"""

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from saltus.arrays import Floats
from saltus.constants import PHYSICS_DT
from saltus.effects.body import claimed_body
from saltus.effects.chain import ActuatorChain, BodyChain, ImuChain, Torques
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import Robot
from saltus.rotations import rotation_matrix
from saltus.sim import robot_model
from saltus.sim.driven_robots import DrivenMotion, DrivenRobots
from saltus.sim.mujoco_batch import MujocoBatch
from saltus.sim.plant import CLEARANCE, standing_pose
from saltus.sim.plant_state import PlantState
from saltus.terrain.terrain import Terrain
from saltus.terrain.terrain_stack import TerrainStack

Indices = NDArray[np.integer]


class BatchPlant(DrivenRobots):
    """`count` robots of one kind that know nothing of each other; the same step as `Plant`.

    Terrain, friction and payload on the trunk [kg] are one for all or one for each robot, shape
    (count,). Effects of the drives may hold one value per robot, shape (count, 1), those of bodies,
    ground and IMUs shape (count,).
    """

    def __init__(
        self,
        robot: Robot,
        terrains: Terrain | Sequence[Terrain],
        count: int,
        *,
        friction: ArrayLike = robot_model.FRICTION,
        payload_kg: ArrayLike = 0.0,
        chain: ActuatorChain | None = None,
        body: BodyChain | None = None,
        imu: ImuChain | None = None,
        threads: int = 0,
    ) -> None:
        super().__init__(robot, (count,), chain, imu)
        given = [terrains] * count if isinstance(terrains, Terrain) else list(terrains)
        self._terrains, self._legs = TerrainStack(given), LegKinematics(robot)
        # Its tree of boxes suits the others too
        longest = max(given, key=lambda terrain: len(terrain.boxes))
        self._body = body or BodyChain()
        # A payload, so that what the engine derives from masses exists for every robot.
        model = robot_model.build_spec(
            robot,
            longest,
            payload_kg=1.0,
            columns=self._terrains.widest,
            dimensions=self._body.contact_dimensions,
        ).compile()
        self._engine = MujocoBatch(robot, model, count, threads=threads)
        self._qacc, self._sensors = (
            self._engine.batch.bind(name) for name in ("qacc", "sensordata")
        )
        self._time, self._believed = np.zeros(count), np.zeros((count, 12))
        self._engine.set_terrain(self._terrains.boxes(self._terrains.widest))
        claimed = claimed_body((count,), friction=friction, payload_kg=payload_kg)
        self._engine.set_bodies(self._body.apply(claimed))
        self._engine.derive(np.arange(count))
        self.reset()

    def push(self, force: Floats) -> None:
        """Pushes trunks sideways, along the world's y, until the next call [N], shape (count,)."""
        self._engine.trunk_wrench[:, 1] = force

    def reset(
        self,
        indices: Indices | None = None,
        *,
        position_x: ArrayLike = 0.0,
        yaw: ArrayLike = 0.0,
        clearance: float = CLEARANCE,
    ) -> PlantState:
        """Puts robots (by default all) at rest in their stand pose;
        each value of shape () or (len(indices),).
        """
        ids = np.arange(len(self._time)) if indices is None else np.asarray(indices)
        x, turn = (
            np.broadcast_to(np.asarray(v, dtype=np.float64), ids.shape) for v in (position_x, yaw)
        )
        self._engine.batch.reset(ids, stage=mujoco.mjtStage.mjSTAGE_NONE)
        terrains = TerrainStack([self._terrains.terrains[int(i)] for i in ids])
        self._engine.qpos[ids] = standing_pose(self.robot, terrains, x, turn, clearance)
        self._engine.batch.forward(ids)
        self._forget(ids)
        self._time[ids] = 0.0
        believed = self._believed.copy()
        believed[ids] = 0.0
        return self._look(believed)

    def _advance(self, torque: Torques) -> None:
        self._engine.ctrl[:], self._believed = torque.applied, np.asarray(torque.believed)
        if (
            resistance := torque.resistance
        ) is not None:  # friction, which the engine integrates implicitly
            self._engine.set_joints(resistance.friction, resistance.damping, resistance.armature)
        self._engine.batch.step()
        self._time += PHYSICS_DT

    def _motion(self) -> DrivenMotion:
        qpos, qvel = self._engine.qpos.copy(), self._engine.qvel.copy()
        rotation = rotation_matrix(qpos[:, 3:7])
        feet: Floats = self._legs.position(qpos[:, 7:]) @ rotation.mT + qpos[:, None, :3]
        return self._time.copy(), qpos, qvel, feet, rotation, self._qacc, self._sensors
