"""Robots with drives and IMUs: what one plant and a batch
of plants do alike around their physics.
"""

from abc import ABC, abstractmethod
from types import EllipsisType

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Floats
from saltus.constants import GRAVITY
from saltus.effects.chain import ActuatorChain, ActuatorState, ImuChain, Torques
from saltus.effects.compiled_chain import DriveStep
from saltus.effects.imu import ImuReading
from saltus.effects.signal_chain import chosen_of
from saltus.joint_command import JointCommand
from saltus.robots.robot import Robot
from saltus.sim import robot_model
from saltus.sim.plant_state import PlantState, sensor_arrays
from saltus.states import SensorArrays

DrivenMotion = tuple[float | Floats, Floats, Floats, Floats, Floats, Floats, Floats]
"""Time [s], `qpos`, `qvel`, centres of the feet in the world [m], rotation of the base, `qacc`,
`sensordata`."""


class DrivenRobots(ABC):
    """Simulated robots with their drives: joint commands in, states out, 2 ms at a time.

    One robot, or with a leading dimension (count,) a batch.

    The drives are ideal by default.
    """

    def __init__(
        self,
        robot: Robot,
        batch: tuple[int, ...],
        chain: ActuatorChain | None,
        imu: ImuChain | None,
    ) -> None:
        self.robot, self._batch = robot, batch
        self._chain, self._imu_chain = (chain or ActuatorChain()).fitted(robot), imu or ImuChain()
        self._actuators: ActuatorState = self._chain.blank
        self._imu_state: tuple[object, ...] = self._imu_chain.blank
        self._drive: DriveStep = self._chain.step
        self._fresh: NDArray[np.bool_] | None = None  # reset since the last step, where some were
        self._state: PlantState
        self._reading: ImuReading

    @property
    def state(self) -> PlantState:
        """The present state."""
        return self._state

    @property
    def imu(self) -> ImuReading:
        """Returns what the IMU reports now."""
        return self._reading

    @property
    def sensed(self) -> SensorArrays:
        """Returns what IMU and encoders report now."""
        return sensor_arrays(self._state, self._reading)

    def step(self, command: JointCommand) -> PlantState:
        """Advances by `PHYSICS_DT`; returns the state at the end of it.

        Arrays of the command have the shape (..., 12).

        Raises:
            SaltusError: the command or the state of a single robot is not finite. A robot of a
                batch whose simulation diverges has a state that is not finite until it is reset;
                the others go on.
        """
        torque, self._actuators = self._drive(
            command, *self._joints, self._now, self._actuators, self._fresh
        )
        self._fresh = None
        self._advance(torque)
        return self._look(np.asarray(torque.believed, dtype=np.float64))

    def _look(self, believed: Floats) -> PlantState:
        """Takes in the state of the physics and passes it to encoders and IMU."""
        time_s, qpos, qvel, feet, rotation, qacc, sensors = self._motion()
        self._joints, self._now = (qpos[..., 7:], qvel[..., 6:]), time_s
        joints = self._chain.measured(*self._joints, time_s, self._actuators, self._fresh)
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
            foot_force=-sensors[
                ..., robot_model.FOOT_FORCE_Z
            ],  # the sensor gives the force that the foot exerts
            foot_position_in_world=feet,
            trunk_contact=sensors[..., robot_model.TRUNK_CONTACT].any(-1),
        )
        true = ImuReading(
            quaternion_base_in_world=state.quaternion_base_in_world,
            angular_velocity_base=state.angular_velocity_base,
            acceleration_base=state.acceleration_base,
        )
        now = self._imu_chain.step(true, time_s, self._imu_state, self._fresh)
        # time goes on for those that were not reset at the next step only
        self._reading, self._imu_state = (
            now
            if self._fresh is None
            else chosen_of(self._fresh, now, (self._reading, self._imu_state))
        )
        return state

    def _forget(self, robots: NDArray[np.integer | np.bool_] | EllipsisType = ...) -> None:
        """Has drives and IMUs of robots that are being reset start with blank memories."""
        fresh = np.zeros(self._batch, dtype=np.bool_) if self._fresh is None else self._fresh
        fresh[robots] = True
        if fresh.all():
            self._actuators, self._imu_state, self._fresh = (
                self._chain.blank,
                self._imu_chain.blank,
                None,
            )
        else:
            self._fresh = fresh

    @abstractmethod
    def _advance(self, torque: Torques) -> None:
        """One step of the physics."""

    @abstractmethod
    def _motion(self) -> DrivenMotion:
        """The present one; only `qacc` and `sensordata` may change later."""


def specific_force(qacc: Floats, rotation: Floats) -> Floats:
    """Accelerometer at the base origin, from the acceleration of the free joint.

    Args:
        qacc: Its first three entries are the acceleration of the base origin, world frame. Shape
            (..., 18).
        rotation: Base to world, shape (..., 3, 3).

    Returns:
        Base frame [m/s^2], shape (..., 3).
    """
    specific_force = qacc[..., :3] + np.array([0.0, 0.0, GRAVITY])
    return np.einsum("...ji,...j->...i", rotation, specific_force)
