"""The simulated robot: the plant of one trial behind the interface of a robot."""

import numpy as np

from saltus.controller.robot.backend import Reading, RobotBackend
from saltus.joint_command import JointCommand
from saltus.setup import Setup
from saltus.sim.plant import Plant
from saltus.sim.state import PlantState
from saltus.wire.messages import GroundTruth


class MujocoRobot(RobotBackend):
    """One robot in MuJoCo, with the hardware of its trial, whose drives may be compiled (`Plant`)."""

    def __init__(self, setup: Setup, *, compiled: bool = False) -> None:
        self.terrain, self._grid = setup.terrain, setup.grid
        self._x, self._y = np.array(setup.grid.x), np.array(setup.grid.y)
        self._trial, profile = setup.trial, setup.hardware
        self._plant = Plant(
            setup.robot,
            setup.terrain,
            friction=setup.trial.friction,
            payload_kg=setup.trial.payload_kg,
            chain=profile.actuator_chain,
            body=profile.body_chain,
            imu=profile.imu_chain,
            compiled=compiled,
        )
        self._trunk_contact = False

    @property
    def state(self) -> PlantState:
        """The true state, which a real robot does not have."""
        return self._plant.state

    def reset(self) -> None:
        """Puts the robot where its trial starts."""
        self._plant.reset(position_x=self._trial.position_x, yaw=self._trial.yaw)
        self._trunk_contact = False

    def read(self) -> Reading:
        """The sensors, without noise: their errors are effects."""
        return Reading(measurement=self._plant.sensed, joint_torque=self._plant.state.joint_torque)

    def write(self, command: JointCommand) -> None:
        """Advances by 2 ms."""
        self._trunk_contact |= bool(self._plant.step(command).trunk_contact)

    def push(self, force: float) -> None:
        """Pushes the trunk along the world's y from now on [N]; 0 ends it."""
        self._plant.push(force)

    def close(self) -> None:
        """Nothing to let go of."""

    def take_trunk_contact(self) -> bool:
        """True where the trunk touched anything since the last call."""
        touched, self._trunk_contact = self._trunk_contact, False
        return touched

    def truth(self, time_ns: int, step: int) -> GroundTruth:
        """The true state and the true terrain ahead, for camera, labels and reports."""
        state = self._plant.state
        w, x, y, z = state.quaternion_base_in_world
        yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        position = state.position_base_in_world
        return GroundTruth(
            time_ns=time_ns,
            step=step,
            position_base_in_world=position,
            quaternion_base_in_world=state.quaternion_base_in_world,
            velocity_base_in_world=state.velocity_base_in_world,
            angular_velocity_base=state.angular_velocity_base,
            joint_position=state.joint_position,
            foot_force=state.foot_force,
            x=self._x,
            y=self._y,
            height=self.terrain.height_at(*self._grid.points_in_world(position, yaw)) - position[2],
        )
