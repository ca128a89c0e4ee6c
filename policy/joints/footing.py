"""A robot that is to stand lets down the feet that its policy has left in the air, and leans."""

import math

import numpy as np

from saltus.arrays import Floats
from saltus.constants import GRAVITY
from saltus.robots.legs import LegKinematics
from saltus.robots.resting_poses import RestingPoses
from saltus.robots.robot import Robot
from saltus.rotations import roll_pitch_yaw, rotation_matrix, yaw_rotation
from saltus.wire.messages import RobotState

LOWERING_MPS = 0.6
"""Speed at which hanging feet go down: the height of a stair, 0.15 m, in a quarter of a second."""
LEAST_SHARE = 0.05
"""Share of the robot's weight below which a foot hangs: the weight of its own leg."""
LEANING = 4.0
"""Speed of the base towards its place over the feet, by the distance from it [1/s]."""
LEANING_MPS = 0.3
"""Greatest speed of the base towards its place over the feet [m/s]."""
SLOW_MPS = 0.15
"""Estimated speed below which a robot is left to the controller's stand."""
LONGEST_NS = 1_000_000_000
"""It ends after this, where a foot finds no ground."""
BEARS_NS = 50_000_000
CENTRED_M = 0.02
"""It ends when all feet have borne weight for so long, and the base is so near to its place."""


class Footing:
    """Brings a walking robot to a stand: lets down hanging feet and leads the base over the feet
    that stand, which do not move.

    Args:
        robot: Which one.
        state: At its begin.
    """

    def __init__(self, robot: Robot, state: RobotState) -> None:
        self._legs, self._poses = LegKinematics(robot), RestingPoses(robot)
        self._least_force = LEAST_SHARE * robot.mass * GRAVITY
        gains = robot.gains
        self.gains = np.full(12, gains.stand_kp), np.full(12, gains.stand_kd)
        """Stiffness [Nm/rad] and damping [Nm s/rad] for the targets, shape (12,) each."""
        self._targets = state.joint_position + state.joint_torque / gains.stand_kp
        self._begun_ns = self._last_ns = self._hung_ns = state.time_ns
        self._away_m = np.inf

    def step(self, state: RobotState) -> Floats:
        """Joint targets at a state [rad], shape (12,); states come in order.

        Where no foot bears weight, torques are not known or the robot falls, and none goes down.
        """
        rotation = rotation_matrix(state.quaternion_base_in_world)
        load = self._legs.load(state.joint_position, state.joint_torque, rotation[2])
        hangs = (load < self._least_force) & (load.max() > self._least_force)
        if hangs.any():
            self._hung_ns = state.time_ns
        passed_s, self._last_ns = 1e-9 * (state.time_ns - self._last_ns), state.time_ns
        in_yaw = yaw_rotation(roll_pitch_yaw(rotation)[2]).mT @ rotation
        foot = self._legs.position(state.joint_position)
        way = self._legs.position(self._poses.over_feet(foot @ in_yaw.mT)) - foot
        self._away_m = float(np.linalg.norm(way.mean(axis=0)))
        length = np.linalg.norm(way, axis=-1, keepdims=True)
        lean = way * np.minimum(LEANING, LEANING_MPS / np.maximum(length.max(), 1e-6))
        down = -LOWERING_MPS * rotation[2]
        asked = self._legs.position(self._targets) + passed_s * (lean + hangs[:, None] * down)
        self._targets = self._legs.inverse(asked)
        return self._targets

    def is_over(self, state: RobotState) -> bool:
        """True where all feet stand and the base rests over them, or where that takes too long."""
        bears = state.time_ns - self._hung_ns >= BEARS_NS
        rests = self._away_m < CENTRED_M and is_slow(state)
        return (bears and rests) or state.time_ns - self._begun_ns >= LONGEST_NS


def is_slow(state: RobotState) -> bool:
    """True below `SLOW_MPS`."""
    return math.hypot(*state.velocity_base_in_world[:2]) < SLOW_MPS
