"""Feet that surely stand, of a robot whose gait nobody knows."""

import numpy as np

from saltus.arrays import Joints, LegFlags, Vectors
from saltus.constants import GRAVITY, PHYSICS_DT
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import Robot
from saltus.rotations import rotation_matrix, skew
from saltus.states import SensorReadings

LEAST_SHARE = 0.15
"""Share of the robot's weight that a standing foot bears at least."""
REST_MPS, STANDS_S = 0.3, 0.02
"""A foot that stands is slower than this, and has been for so long. Torques alone, also of 20 ms,
take legs that swing for standing ones: 8 to 11 % of the feet that a Go2 would have trusted on
rubble and stairs were in the air, 0.1 to 2 % of those of a Go1 and a Go2 with the speed. 82 to 89 %
of the standing ones are found."""
DOUBT_MPS2 = 3.0
"""So fast grows the speed that is allowed while no foot stands: in flight, and where the velocity
of the base is so wrong that feet at rest seem to move, which would go on for ever."""


class StandingFeet:
    """Tells from tick to tick which feet surely stand: each bears a part of the weight, and rests.

    Torques of the joints say the first, masses of the legs left out; joints, gyroscope and the
    velocity of the base say the second.
    """

    def __init__(self, robot: Robot) -> None:
        self._legs, self._least_force = LegKinematics(robot), LEAST_SHARE * robot.mass * GRAVITY
        self._stood_s = np.zeros(4)
        self._none_s = 0.0

    def step(
        self, measured: SensorReadings, torque: Joints, velocity_base_in_world: Vectors
    ) -> LegFlags:
        """The feet that surely stand, bool, shape (4,); to be asked every 2 ms.

        Args:
            measured: Attitude, turning and joints now.
            torque: As the drives believe it [Nm], shape (12,).
            velocity_base_in_world: As estimated [m/s], shape (3,).
        """
        rotation = rotation_matrix(measured.quaternion_base_in_world)
        foot, jacobian = self._legs.position_and_jacobian(measured.joint_position)
        joints = measured.joint_velocity.reshape(4, 3, 1)
        relative = (jacobian @ joints)[..., 0] + foot @ skew(measured.angular_velocity_base).mT
        speed = np.linalg.norm(relative @ rotation.mT + velocity_base_in_world, axis=-1)
        bears = self._legs.load_by(jacobian, torque, rotation[2]) > self._least_force
        rests = speed < REST_MPS + DOUBT_MPS2 * self._none_s
        self._stood_s = np.where(bears & rests, self._stood_s + PHYSICS_DT, 0.0)
        stands = self._stood_s > STANDS_S - 0.5 * PHYSICS_DT
        self._none_s = 0.0 if stands.any() else self._none_s + PHYSICS_DT
        return np.asarray(stands)
