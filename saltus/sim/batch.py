"""Many robots at once on the cores of a CPU, each with its own terrain, friction and payload."""

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import ArrayLike, NDArray

from saltus.constants import PHYSICS_DT
from saltus.effects.body import BodyChain, claimed_body
from saltus.effects.chain import ActuatorChain, Torques
from saltus.effects.imu import ImuChain, ImuReading
from saltus.effects.signals import JointState, Resistance
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import Robot
from saltus.rotations import rotation_matrix
from saltus.sim import scene
from saltus.sim.bounds import terrain_nodes, tree_bounds
from saltus.sim.plant import CLEARANCE, specific_force, standing_pose
from saltus.sim.state import Floats, PlantState, sensed
from saltus.states import Sensed
from saltus.terrain.stack import TerrainStack
from saltus.terrain.terrain import Terrain
from saltus.wire.messages import JointCommand

Indices = NDArray[np.integer]


class BatchPlant:
    """`count` robots that know nothing of each other; the same step as `Plant`.

    Args:
        robot: Which one, for all.
        terrains: One for all, or one for each robot.
        count: Number of robots.
        friction: Coefficient of friction, one for all or shape (count,).
        payload_kg: Mass on top of the trunk [kg], one for all or shape (count,).
        chain: What the drives do; its effects may hold one value per robot, shape (count, 1).
        body: What is otherwise than claimed about bodies and ground; one value per robot has shape (count,).
        imu: What the IMUs make of the motion of the bases, likewise.
        seed: Of the randomness in the drives.
        columns: Number of terrain boxes, where later terrains may have more than the first.
        threads: Number of threads; 0 is one for each core.
    """

    def __init__(
        self,
        robot: Robot,
        terrains: Terrain | Sequence[Terrain],
        count: int,
        *,
        friction: ArrayLike = scene.FRICTION,
        payload_kg: ArrayLike = 0.0,
        chain: ActuatorChain | None = None,
        body: BodyChain | None = None,
        imu: ImuChain | None = None,
        seed: int = 0,
        columns: int | None = None,
        threads: int = 0,
    ) -> None:
        given = [terrains] * count if isinstance(terrains, Terrain) else list(terrains)
        self.terrains = TerrainStack(given)
        self.robot, self.count = robot, count
        self._legs = LegKinematics(robot)
        self._columns = columns or self.terrains.widest
        longest = max(given, key=lambda terrain: len(terrain.boxes))  # its tree of boxes suits the others too
        # A payload, so that what the engine derives from masses exists for every robot.
        self.model = scene.build_spec(robot, longest, payload_kg=1.0, columns=self._columns).compile()
        self._chain = (chain or ActuatorChain()).fitted(robot)
        self._rng = np.random.default_rng(seed)
        self._body, self._imu = body or BodyChain(), imu or ImuChain()
        self._claimed_friction, self._claimed_payload_kg = np.zeros(count), np.zeros(count)
        self._batch = Batch(self.model, nsim=count, nthread=threads)
        self._bind()
        self._actuators: Any = None
        self._imu_state: Any = None
        self._reading: ImuReading
        self._fresh = np.ones(count, dtype=np.bool_)
        self._time = np.zeros(count)
        self._state: PlantState
        everyone = np.arange(count)
        self.set_terrains(everyone, given)
        self.set_bodies(everyone, friction, payload_kg)
        self.reset()

    def set_terrains(self, indices: Indices, terrains: Sequence[Terrain]) -> None:
        """Puts other terrains under some robots; reset those robots next."""
        every = list(self.terrains.terrains)
        for i, terrain in zip(indices, terrains, strict=True):
            every[i] = terrain
        self.terrains = TerrainStack(every)
        boxes = TerrainStack(terrains).boxes(self._columns)
        where = np.ix_(indices, self._boxes)
        self._geom_pos[where] = boxes.center
        self._geom_size[where] = boxes.half_size
        self._geom_rbound[where] = np.linalg.norm(boxes.half_size, axis=-1)
        self._geom_aabb[where] = np.concatenate([np.zeros_like(boxes.center), boxes.half_size], axis=-1)
        self._bvh[indices, terrain_nodes(self.model)] = tree_bounds(self.model, self._boxes, boxes)
        if boxes.turn is not None or self._batch.expanded("geom_quat") is not None:
            self._batch.expand("geom_quat")[where] = boxes.quaternion
            # a box that was compiled level would keep the axes of the world
            self._batch.expand("geom_sameframe")[where] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE

    def set_bodies(self, indices: Indices, friction: ArrayLike, payload_kg: ArrayLike) -> None:
        """Gives some robots other soles and payloads; shapes () or (len(indices),)."""
        self._claimed_friction[indices], self._claimed_payload_kg[indices] = friction, payload_kg
        body = self._body.apply(
            claimed_body((self.count,), friction=self._claimed_friction, payload_kg=self._claimed_payload_kg)
        )
        geoms, mass = np.ix_(indices, self._robot_geoms), body.payload_kg[indices]
        self._geom_friction[(*geoms, 0)] = body.friction[indices, None]
        self._geom_solref[(*geoms, 0)] = body.contact_time_constant[indices, None]
        self._body_mass[indices, self._payload] = mass
        self._body_inertia[indices, self._payload] = mass[:, None] * scene.payload_inertia(1.0)
        self._body_ipos[indices, self._trunk] = self.model.body_ipos[self._trunk] + body.com_shift[indices]
        scale = body.inertia_scale[indices, None]
        self._body_inertia[indices, self._trunk] = scale * self.model.body_inertia[self._trunk]
        self._batch.set_const(indices)

    def reset(
        self,
        indices: Indices | None = None,
        *,
        position_x: ArrayLike = 0.0,
        yaw: ArrayLike = 0.0,
        position_y: ArrayLike = 0.0,
        clearance: float = CLEARANCE,
    ) -> PlantState:
        """Puts robots (by default all) at rest in their stand pose; each value of shape () or (len(indices),)."""
        ids = np.arange(self.count) if indices is None else np.asarray(indices)
        x, turn, y = (
            np.broadcast_to(np.asarray(v, dtype=np.float64), ids.shape) for v in (position_x, yaw, position_y)
        )
        self._batch.reset(ids, stage=mujoco.mjtStage.mjSTAGE_NONE)
        terrains = TerrainStack([self.terrains.terrains[int(i)] for i in ids])
        self._qpos[ids] = standing_pose(self.robot, terrains, x, turn, y, clearance)
        self._batch.forward(ids)
        self._fresh[ids] = True
        self._time[ids] = 0.0
        self._believed[ids] = 0.0
        self._state = self._observe()
        self._measure()
        return self._state

    @property
    def state(self) -> PlantState:
        """The present state."""
        return self._state

    @property
    def imu(self) -> ImuReading:
        """What the IMUs report now."""
        return self._reading

    @property
    def sensed(self) -> Sensed:
        """What IMU and encoders report now."""
        return sensed(self._state, self._reading)

    def step(self, command: JointCommand) -> PlantState:
        """Advances all robots by `PHYSICS_DT`; the command's arrays have shape (count, 12).

        A robot whose simulation diverges has a state that is not finite until it is reset; the others go on.
        """
        torque = self._drive(command)
        self._ctrl[:] = torque.applied
        if torque.resistance is not None:
            self._resist(torque.resistance)
        self._batch.step()
        self._time += PHYSICS_DT
        self._believed = np.array(torque.believed, dtype=np.float64)
        self._state = self._observe()
        self._measure()
        return self._state

    def _drive(self, command: JointCommand) -> Torques:
        """The actuator chain; robots that were reset start with an empty memory, the others keep theirs."""
        time_s = float(self._time.max())
        inputs = (command, self._qpos[:, 7:].copy(), self._qvel[:, 6:].copy(), time_s)
        if not self._fresh.any():
            torque, self._actuators = self._chain.step(*inputs, self._actuators)
            return torque
        fresh, self._fresh = self._fresh, np.zeros(self.count, dtype=np.bool_)
        torque, state = self._chain.step(*inputs, self._chain.init((self.count,), self._rng))
        if not fresh.all():
            kept, old = self._chain.step(*inputs, self._actuators)
            torque = Torques(
                applied=_merged(fresh, torque.applied, kept.applied),
                believed=_merged(fresh, torque.believed, kept.believed),
                resistance=_merged(fresh, torque.resistance, kept.resistance),
            )
            state = _merged(fresh, state, old)
        self._actuators = state
        return torque

    def _resist(self, resistance: Resistance) -> None:
        """Hands friction to the engine, which integrates it implicitly."""
        self._batch.expand("dof_frictionloss")[:, 6:] = resistance.friction
        self._batch.expand("dof_damping")[:, 6:] = resistance.damping
        self._batch.expand("dof_armature")[:, 6:] = self.robot.armature + resistance.armature

    def _measured(self, position: Floats, velocity: Floats) -> JointState:
        """What the drives measure; robots that were reset have encoders without memory."""
        motion = (position, velocity, float(self._time.max()))
        if not self._fresh.any():
            return self._chain.measured(*motion, self._actuators)
        start = self._chain.measured(*motion, self._chain.init((self.count,), np.random.default_rng(0)))
        if self._fresh.all():
            return start
        kept = self._chain.measured(*motion, self._actuators)
        return JointState(
            position=_merged(self._fresh, start.position, kept.position),
            velocity=_merged(self._fresh, start.velocity, kept.velocity),
        )

    def _bind(self) -> None:
        batch, model = self._batch, self.model
        self._qpos, self._qvel, self._ctrl = batch.bind("qpos"), batch.bind("qvel"), batch.bind("ctrl")
        self._qacc, self._sensors = batch.bind("qacc"), batch.bind("sensordata")
        self._believed = np.zeros((self.count, 12))
        self._boxes = np.array([model.geom(scene.TERRAIN_GEOM.format(i)).id for i in range(self._columns)])
        self._robot_geoms = np.flatnonzero(model.geom_group == scene.ROBOT_GROUP)
        self._payload, self._trunk = model.body(scene.PAYLOAD).id, model.body(scene.TRUNK).id
        self._geom_pos, self._geom_size = batch.expand("geom_pos"), batch.expand("geom_size")
        self._geom_rbound, self._geom_friction = batch.expand("geom_rbound"), batch.expand("geom_friction")
        self._geom_aabb = batch.expand("geom_aabb").reshape(self.count, model.ngeom, 6)
        self._bvh = batch.expand("bvh_aabb")
        self._geom_solref, self._body_ipos = batch.expand("geom_solref"), batch.expand("body_ipos")
        self._body_mass, self._body_inertia = batch.expand("body_mass"), batch.expand("body_inertia")

    def _measure(self) -> None:
        """The IMUs; those of robots that were reset have an empty memory, the others keep theirs."""
        now, time_s = self._state, float(self._time.max())
        true = ImuReading(
            quaternion_base_in_world=now.quaternion_base_in_world,
            angular_velocity_base=now.angular_velocity_base,
            acceleration_base=now.acceleration_base,
        )
        fresh = self._time == 0.0
        if self._imu_state is None or fresh.any():
            start = self._imu.step(true, time_s, self._imu.init((self.count,), self._rng))
            if self._imu_state is None or fresh.all():
                self._reading, self._imu_state = start
                return
        reading, state = self._imu.step(true, time_s, self._imu_state)
        if fresh.any():
            reading = _merged(fresh, start[0], reading)
            state = _merged(fresh, start[1], state)
        self._reading, self._imu_state = reading, state

    def _observe(self) -> PlantState:
        qpos, qvel = self._qpos.copy(), self._qvel.copy()
        rotation = rotation_matrix(qpos[:, 3:7])
        joints = self._measured(qpos[:, 7:], qvel[:, 6:])
        feet: Floats = self._legs.position(qpos[:, 7:]) @ rotation.mT + qpos[:, None, :3]
        return PlantState(
            time_s=self._time.copy(),
            position_base_in_world=qpos[:, :3],
            quaternion_base_in_world=qpos[:, 3:7],
            velocity_base_in_world=qvel[:, :3],
            angular_velocity_base=qvel[:, 3:6],
            acceleration_base=specific_force(self._qacc, rotation),
            joint_position=np.asarray(joints.position, dtype=np.float64),
            joint_velocity=np.asarray(joints.velocity, dtype=np.float64),
            joint_torque=self._believed,
            foot_force=-self._sensors[:, scene.FOOT_FORCE].reshape(-1, 4, 3)[..., 2],
            foot_position_in_world=feet,
            trunk_contact=self._sensors[:, scene.TRUNK_CONTACT].any(axis=1),
        )


def _merged(fresh: NDArray[np.bool_], new: Any, old: Any) -> Any:
    """Rows of `new` for robots that are fresh, of `old` for the others, through nested tuples and signals."""
    if isinstance(new, ImuReading | Resistance):
        return type(new)(**{f.name: _merged(fresh, getattr(new, f.name), getattr(old, f.name)) for f in fields(new)})
    if isinstance(new, tuple):
        return tuple(_merged(fresh, a, b) for a, b in zip(new, old, strict=True))
    if isinstance(new, np.ndarray):
        return np.where(fresh.reshape((-1,) + (1,) * (new.ndim - 1)), new, old)
    return old
