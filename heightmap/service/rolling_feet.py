"""Corrects odometry for feet that roll: a robot is faster than round feet at rest would say.

Velocity by the legs is that of the base over a foot. A foot's centre moves on as the shank turns
over its sole: with soles of 0.02 m and legs of 0.3 m a robot is 7 % faster than over feet whose
centres rest. A map into which images come 7 % too near is doubled at its edges.

A soft foot, or one on soft ground, sinks in and rolls over what is left of its radius. By how much
it sinks, images tell: they show ground above its underside.
"""

import numpy as np

from saltus.arrays import Floats
from saltus.constants import POLICY_DT
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import Robot
from saltus.rotations import rotation_matrix, skew
from saltus.wire.messages import RobotState

MEAN_S = 0.2
"""Time of standing over which it is averaged: half a bound (on eight courses velocities added up to
0.98 to 1.02 of the true distance; to 0.91 to 0.96 without)."""
SINKS_S = (0.1, 0.5)
"""Times of standing, at first and later, over which the depth is averaged by which feet sink: a
robot has only one stance or two on ground that it saw before it comes to the first edge.
Distances to the ground of images are off by 2 to 4 mm, those beside edges by more."""
MOST_MPS = 0.3
"""A foot by which the robot is faster than this slips or does not stand."""


class RollingFeet:
    """Velocity that a robot's states leave out, by its legs and the height of its feet's centres.

    Attributes:
        sole: Height of the centre of a standing foot above the ground [m]: the foot's radius, less
            what it sinks by.
        centres: Of the feet in the base frame [m] at the last state in which one stood, shape
            (4, 3).
    """

    def __init__(self, robot: Robot) -> None:
        self._legs, self._radius = LegKinematics(robot), robot.foot_radius
        self.sole, self._stood = self._radius, 0
        self.centres = np.zeros((4, 3))
        self._missing = np.zeros(3)

    def stand(self, gap: Floats) -> None:
        """Takes in a state in which feet stand.

        Args:
            gap: Ground that images show, above the underside of each standing foot by `sole` [m],
                shape (n,).
        """
        if len(gap):
            self._stood += 1
            share = POLICY_DT / min(max(POLICY_DT * self._stood, SINKS_S[0]), SINKS_S[1])
            self.sole = min(max(self.sole - share * float(np.mean(gap)), 0.0), self._radius)

    def missing(self, state: RobotState) -> Floats:
        """Horizontal velocity that a state leaves out, along the world's axes [m/s], shape (3,).

        It is known of a robot whose feet stand, and held while none does.
        """
        trusted = np.asarray(state.leg_trusted, np.bool_)
        if trusted.any():
            off = self._velocity(state)[trusted] - np.asarray(state.velocity_base_in_world)
            off[:, 2] = 0.0  # vertically soles do not roll
            off = off[(off**2).sum(-1) ** 0.5 < MOST_MPS]
            if len(off):
                share = POLICY_DT / MEAN_S
                self._missing = self._missing + share * (off.mean(0) - self._missing)
        return self._missing

    def _velocity(self, state: RobotState) -> Floats:
        """Velocity of the base over each foot, if it rolls on its sole,
        in the world [m/s], shape (4, 3).
        """
        rotation = rotation_matrix(np.asarray(state.quaternion_base_in_world, np.float64))
        turn = np.asarray(state.angular_velocity_base, np.float64)
        position = np.asarray(state.joint_position, np.float64)
        joint = np.asarray(state.joint_velocity, np.float64).reshape(4, 3)
        self.centres, jacobian = self._legs.position_and_jacobian(position)
        relative = (jacobian @ joint[..., None])[..., 0] + self.centres @ skew(turn).T
        abduction, bend = position.reshape(4, 3)[:, 0], joint[:, 1] + joint[:, 2]
        shank = turn + np.stack(
            [joint[:, 0], np.cos(abduction) * bend, np.sin(abduction) * bend], axis=-1
        )
        rolling = (shank @ rotation.T) @ skew(np.array([0.0, 0.0, -self.sole])).T
        return np.asarray(rolling - relative @ rotation.T)
