"""Swing legs: Raibert's heuristic plus a learned residual, tracked at the joints.

A foot goes from where it lifted off, under its hip, to the neutral point ahead of the hip, in two
cubic segments that meet at half time. The nominal path stays at ground height: the whole lift comes
from the residual. Source: paper ("Gait Generation and Swing Leg Control"); numbers: original.
"""

import numpy as np

from saltus.arrays import Constant, Joints, Legs, PerLeg, Scalars, namespace, smooth_step
from saltus.constants import GRAVITY
from saltus.controller.yaw_frame import YawFrameBody
from saltus.footholds import Footholds
from saltus.robots.legs import LegKinematics
from saltus.robots.robot import Robot
from saltus.robots.similarity import Similarity

JOINT_MARGIN_RAD = 1e-3
"""Distance that targets keep from the joint limits; original."""
JOINT_STEP_RAD = 0.5
"""Distance that targets keep to the present joint angle; original."""
BENT_FROM_MPS = 1.65
"""Speed from which knees are bent by all of `Gains.landing_bend`, for a robot of the reference's
size: a Go2 lands behind a gap of 0.8 m at 2 to 2.5 m/s, and jumps up stairs at 1.2, where legs of
full length reach the next tread."""
_FOLD = Constant([0.0, 0.5, -1.0])
"""Joint angles by the angle by which a knee is bent: the foot stays in its direction."""


class SwingLegs:
    """Targets of the feet and joints of swinging legs.

    Computed for all legs, used where they swing.
    """

    def __init__(self, robot: Robot) -> None:
        x, y = robot.neutral_foot
        low, high = robot.swing_foot_z
        self._legs = LegKinematics(robot)
        self._footholds = Footholds(robot)
        self._hip = Constant([[x, -y, 0.0], [x, y, 0.0], [-x, -y, 0.0], [-x, y, 0.0]])
        self._landing_limit = Constant([*robot.landing_reach, 0.0])
        self._horizontal = Constant([1.0, 1.0, 0.0])
        self._down = Constant([0.0, 0.0, -1.0])
        self._foot_low = Constant([-np.inf, -np.inf, low])
        self._foot_high = Constant([np.inf, np.inf, high])
        self._joint_low = Constant(robot.joint_lower + JOINT_MARGIN_RAD)
        self._joint_high = Constant(robot.joint_upper - JOINT_MARGIN_RAD)
        size = Similarity.of_robot(robot)
        self._bend, self._straight = robot.gains.landing_bend, robot.thigh_zero - robot.shin_zero
        self._bent_from = BENT_FROM_MPS * size.length / size.time

    def nominal_path(
        self,
        body: YawFrameBody,
        liftoff: Legs,
        progress: PerLeg,
        stance_duration: Scalars,
        base_height: Scalars,
    ) -> Legs:
        """Position of the feet relative to the base without the residual,
        yaw frame [m], shape (..., 4, 3).

        Args:
            body: the robot now.
            liftoff: foot relative to the base at lift-off, yaw frame [m], shape (..., 4, 3).
            progress: of the swing, [0, 1], shape (..., 4).
            stance_duration: [s], shape (...).
            base_height: base over terrain [m], shape (...).
        """
        middle, step = self._footholds.middle_and_step(
            body.base_in_yaw, body.velocity, body.angular_velocity, stance_duration, base_height
        )
        t = progress[..., None]
        first = smooth_step(2.0 * t)
        second = smooth_step(2.0 * t - 1.0)
        return liftoff + (middle - liftoff) * first + step * second

    def capture_point(self, body: YawFrameBody, height: float) -> Legs:
        """Places where feet must stand to bring the body to rest at a height [m]:
        hip + velocity sqrt(height / g).

        The capture point of the linear inverted pendulum, within the landing limits; yaw frame,
        shape (..., 4, 3).
        """
        xp = namespace(body.roll)
        hip = self._hip.like(body.roll) @ body.base_in_yaw.mT
        limit = self._landing_limit.like(body.roll)
        step = xp.clip(body.velocity * float(np.sqrt(height / GRAVITY)), -limit, limit)
        ground = height * self._down.like(body.roll)
        return hip * self._horizontal.like(body.roll) + (step + ground)[..., None, :]

    def joint_target(self, body: YawFrameBody, target: Legs, joint_position: Joints) -> Joints:
        """Joint angles [rad], shape (..., 12), for feet at `target`, with every clip applied.

        Args:
            body: the robot now.
            target: foot relative to the base, yaw frame [m], shape (..., 4, 3).
            joint_position: measured [rad], shape (..., 12).
        """
        xp = namespace(target)
        low, high = self._foot_low.like(target), self._foot_high.like(target)
        foot_base = xp.clip(target @ body.base_in_yaw, low, high)
        lower, upper = self._joint_low.like(target), self._joint_high.like(target)
        angles = xp.clip(self._legs.inverse(foot_base), lower, upper)
        if self._bend > 0.0:
            angles = xp.clip(self._bent(body, angles), lower, upper)
        step = JOINT_STEP_RAD
        return xp.minimum(xp.maximum(angles, joint_position - step), joint_position + step)

    def _bent(self, body: YawFrameBody, angles: Joints) -> Joints:
        """Angles at which no knee is straighter than the robot's speed allows.

        The ground turns the knee of a leg of two links l by the speed at which hip and foot near
        each other over l sin(bend / 2): the straighter the leg, the faster.
        """
        xp = namespace(angles)
        x, y = body.velocity[..., 0], body.velocity[..., 1]
        share = xp.clip(xp.sqrt(x * x + y * y) / self._bent_from, 0.0, 1.0)
        legs = angles.reshape((*angles.shape[:-1], 4, 3))
        over = xp.clip(legs[..., 2] - self._straight + self._bend * share[..., None], 0.0, None)
        return (legs + over[..., None] * _FOLD.like(angles)).reshape(angles.shape)
