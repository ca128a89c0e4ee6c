"""The simulated robot: the plant of one trial behind the interface of a robot."""

import numpy as np

from saltus.arrays import Floats
from saltus.controller.robot.backend import CourseRobot, RobotReading, true_grid_heights
from saltus.joint_command import JointCommand
from saltus.setup import Setup
from saltus.sim.plant import Plant
from saltus.sim.plant_state import PlantState
from saltus.wire.messages import GroundTruth


class MujocoRobot(CourseRobot):
    """One robot in MuJoCo, with the hardware of its trial,
    whose drives may be compiled (`Plant`).
    """

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

    def read(self) -> RobotReading:
        """The sensors, without noise: their errors are effects."""
        return RobotReading(
            measurement=self._plant.sensed, joint_torque=self._plant.state.joint_torque
        )

    def write(self, command: JointCommand) -> None:
        """Advances by 2 ms."""
        self._trunk_contact |= bool(self._plant.step(command).trunk_contact)

    def push(self, force: float) -> None:
        """See `CourseRobot.push`."""
        self._plant.push(force)

    def close(self) -> None:
        """Nothing to let go of."""

    def take_trunk_contact(self) -> bool:
        """See `CourseRobot.take_trunk_contact`."""
        touched, self._trunk_contact = self._trunk_contact, False
        return touched

    def pose(self) -> tuple[Floats, Floats]:
        """See `CourseRobot.pose`."""
        state = self._plant.state
        return state.position_base_in_world, state.quaternion_base_in_world

    def truth(self, time_ns: int, step: int) -> GroundTruth:
        """See `CourseRobot.truth`."""
        state = self._plant.state
        position, quaternion = self.pose()
        return GroundTruth(
            time_ns=time_ns,
            step=step,
            position_base_in_world=position,
            quaternion_base_in_world=quaternion,
            velocity_base_in_world=state.velocity_base_in_world,
            angular_velocity_base=state.angular_velocity_base,
            joint_position=state.joint_position,
            foot_force=state.foot_force,
            x=self._x,
            y=self._y,
            height=true_grid_heights(self.terrain, self._grid, position, quaternion),
        )
