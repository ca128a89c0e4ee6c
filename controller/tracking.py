"""Joint targets of a policy: the command that holds them, and which feet then stand."""

import numpy as np

from saltus.arrays import Joints, LegFlags
from saltus.constants import GRAVITY
from saltus.controller.compensation import Compensation
from saltus.joint_command import JointCommand
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import Robot
from saltus.rotations import rotation_matrix
from saltus.states import SensorReadings
from saltus.wire.messages import JointPlan

LEAST_SHARE = 0.13
"""Share of the robot's weight that a foot bears at least which is taken to stand. A Go1 that trots
at 1.2 m/s moves its legs with torques as of -12 to 26 N at feet in the air (5th and 95th
percentile): at 16 N, this share, as many of them are taken to stand as standing ones are missed, 8
and 7 % of all feet."""


class JointTargetTracking:
    """Follows joint targets of one robot; laws for any leading batch dimensions."""

    def __init__(self, robot: Robot, compensation: Compensation | None = None) -> None:
        self._legs, self._compensation = LegKinematics(robot), compensation
        self._least_force = LEAST_SHARE * robot.mass * GRAVITY

    def command(self, plan: JointPlan) -> JointCommand:
        """Command that holds a plan's targets."""
        zero = np.zeros_like(plan.joint_position)
        command = JointCommand(
            position=plan.joint_position, velocity=zero, kp=plan.kp, kd=plan.kd, torque=zero
        )
        return command if self._compensation is None else self._compensation(command)

    def contact(self, measured: SensorReadings, torque: Joints) -> LegFlags:
        """Feet on which the robot stands, bool, shape (..., 4), by the torques of its joints.

        No schedule says it. Masses of the legs are left out.

        Args:
            measured: Attitude and joints now.
            torque: As the drives believe it [Nm], shape (..., 12).
        """
        upright = rotation_matrix(measured.quaternion_base_in_world)[..., 2, :]
        load = self._legs.load(measured.joint_position, torque, upright)
        return load > self._least_force
