"""Robots with drives and IMUs: what one plant and a batch of plants do alike around their physics."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from saltus.constants import GRAVITY
from saltus.effects.chain import ActuatorChain, ImuChain, Torques
from saltus.effects.effect import map_arrays
from saltus.effects.imu import ImuReading
from saltus.effects.order import Chain
from saltus.robots.robot import Robot
from saltus.sim import scene
from saltus.sim.state import Floats, PlantState, sensed
from saltus.states import Sensed
from saltus.wire.messages import JointCommand

Motion = tuple[float | Floats, Floats, Floats, Floats, Floats, Floats, Floats]
"""Time [s], `qpos`, `qvel`, centres of the feet in the world [m], rotation of the base, `qacc`, `sensordata`."""
Result = TypeVar("Result")


class DrivenRobots(ABC):
    """Joint commands in, states out, 2 ms at a time; one robot, or with a leading dimension (count,) a batch.

    The drives are ideal by default. The seed is that of the randomness in drives and IMU.
    """

    def __init__(
        self, robot: Robot, batch: tuple[int, ...], chain: ActuatorChain | None, imu: ImuChain | None, seed: int
    ) -> None:
        self.robot, self._batch = robot, batch
        self._chain, self._imu_chain = (chain or ActuatorChain()).fitted(robot), imu or ImuChain()
        self._rng = np.random.default_rng(seed)
        self._fresh: NDArray[np.bool_] = np.ones(batch, dtype=np.bool_)  # reset since the last step
        self._any_fresh = True
        self._actuators: Any = None
        self._imu_state: Any = None
        self._state: PlantState
        self._reading: ImuReading

    @property
    def state(self) -> PlantState:
        """The present state."""
        return self._state

    @property
    def imu(self) -> ImuReading:
        """What the IMU reports now."""
        return self._reading

    @property
    def sensed(self) -> Sensed:
        """What IMU and encoders report now."""
        return sensed(self._state, self._reading)

    def step(self, command: JointCommand) -> PlantState:
        """Advances by `PHYSICS_DT`; returns the state at the end of it. Arrays of the command have the shape (..., 12).

        Raises:
            SaltusError: the command or the state of a single robot is not finite. A robot of a batch whose simulation
                diverges has a state that is not finite until it is reset; the others go on.
        """
        chain = self._chain
        torque, self._actuators = self._renewed(chain, chain.step, self._actuators, command, *self._joints, self._now)
        if self._any_fresh:
            self._fresh, self._any_fresh = np.zeros(self._batch, dtype=np.bool_), False
        self._advance(torque)
        return self._look(np.asarray(torque.believed, dtype=np.float64))

    def _look(self, believed: Floats) -> PlantState:
        """Takes in the state of the physics and passes it to encoders and IMU."""
        time_s, qpos, qvel, feet, rotation, qacc, sensors = self._motion()
        chain, self._joints = self._chain, (qpos[..., 7:], qvel[..., 6:])
        self._now = now = float(np.max(time_s)) if self._batch else float(time_s)
        joints = self._renewed(chain, chain.measured, self._actuators, *self._joints, now)
        self._state = state = PlantState(
            time_s=time_s,
            position_base_in_world=qpos[..., :3],
            quaternion_base_in_world=qpos[..., 3:7],
            velocity_base_in_world=qvel[..., :3],
            angular_velocity_base=qvel[..., 3:6],
            acceleration_base=specific_force(qacc, rotation),
            joint_position=np.asarray(joints.position, dtype=np.float64),
            joint_velocity=np.asarray(joints.velocity, dtype=np.float64),
            joint_torque=believed,
            foot_force=-sensors[..., scene.FOOT_FORCE_Z],  # the sensor gives the force that the foot exerts
            foot_position_in_world=feet,
            trunk_contact=sensors[..., scene.TRUNK_CONTACT].any(-1),
        )
        true = ImuReading(
            quaternion_base_in_world=state.quaternion_base_in_world,
            angular_velocity_base=state.angular_velocity_base,
            acceleration_base=state.acceleration_base,
        )
        imu = self._imu_chain
        self._reading, self._imu_state = self._renewed(imu, imu.step, self._imu_state, true, now)
        return state

    def _renewed(self, chain: Chain, run: Callable[..., Result], memory: Any, *inputs: Any) -> Result:
        """`run` of a chain with its memory, which is a blank one for robots that were reset; the others keep theirs."""
        if not self._any_fresh:
            return run(*inputs, memory)
        start = run(*inputs, chain.init(self._batch, self._rng))
        if memory is None or self._fresh.all():
            return start
        return cast(Result, map_arrays(self._of_fresh, start, run(*inputs, memory)))

    def _of_fresh(self, new: Floats, old: Floats) -> Floats:
        return np.where(self._fresh.reshape((-1,) + (1,) * (new.ndim - 1)), new, old)

    def _forget(self, robots: Any = ...) -> None:
        """Has drives and IMUs of robots that are being reset start with blank memories."""
        self._fresh[robots], self._any_fresh = True, True

    @abstractmethod
    def _advance(self, torque: Torques) -> None:
        """One step of the physics."""

    @abstractmethod
    def _motion(self) -> Motion:
        """The present one; only `qacc` and `sensordata` may change later."""


def specific_force(qacc: Floats, rotation: Floats) -> Floats:
    """Accelerometer at the base origin, base frame [m/s^2], shape (..., 3), from the acceleration of the free joint.

    `qacc`, shape (..., 18), begins with that of the base origin in the world; `rotation` is base to world.
    """
    specific_force = qacc[..., :3] + np.array([0.0, 0.0, GRAVITY])
    return np.einsum("...ji,...j->...i", rotation, specific_force)
