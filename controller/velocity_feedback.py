"""Velocity feedback of stance legs: the joints are damped towards the motion
that the body should have; and of all legs, where joints near their rated speed.

A foot that stands still in the world while the base moves at its reference has the velocity -(v + w
x p) in the base frame; the inverse leg Jacobian turns it into joint velocities, and the drives
track those with a small gain. Source: paper ("Feedback Velocity Tracking").
"""

from dataclasses import replace

from saltus.arrays import Array, Constant, Jacobians, Joints, Legs, Vectors, namespace
from saltus.controller.yaw_frame import YawFrameBody
from saltus.joint_command import JointCommand
from saltus.robots.robot import Robot
from saltus.robots.similarity import Similarity
from saltus.rotations import skew

DAMPING_M = 0.005
"""Damping of the inverse Jacobian: its gain is at most 1 / (2 damping). In the standing pose, where
the smallest singular value is 0.1 m, it changes the result by 0.2 %."""


class VelocityFeedback:
    """Reference joint velocities of legs in stance.

    The gain of the feedback is `Gains.stance_kd`, with which 0 leaves feed-forward only.
    """

    def __init__(self, robot: Robot) -> None:
        damping = DAMPING_M * Similarity.of_robot(robot).length
        self._identity = Constant(
            [[float(i == j) * damping**2 for j in range(3)] for i in range(3)]
        )
        self._limit = Constant(robot.speed_limit)

    def joint_velocity(
        self, body: YawFrameBody, velocity: Vectors, angular_velocity: Vectors
    ) -> Joints:
        """Joint velocities [rad/s], shape (..., 12), within the drives' speed limits.

        Args:
            body: the robot now.
            velocity: reference of the base, yaw frame [m/s], shape (..., 3).
            angular_velocity: reference, yaw frame [rad/s], shape (..., 3).
        """
        xp = namespace(velocity)
        velocity_base = velocity[..., None, :] @ body.base_in_yaw
        angular_base = (angular_velocity[..., None, :] @ body.base_in_yaw)[..., 0, :]
        foot_velocity = -(velocity_base + body.foot_base @ skew(angular_base).mT)
        transposed = body.jacobian.mT
        damped = transposed @ body.jacobian + self._identity.like(velocity)
        joint = _solve_symmetric(xp, damped, (transposed @ foot_velocity[..., None])[..., 0])
        limit = self._limit.like(velocity)
        return xp.clip(joint.reshape((*velocity.shape[:-1], 12)), -limit, limit)


class SpeedBrake:
    """Damping of joints that near the speed that they are rated for (`Gains.brake_kd`).

    A leg that leaves the ground while it still pushes runs away, and a late feed-forward torque
    does not stop it. The drives' own damping does: below 0.8 of the rated speed there is none, at
    the rated speed the whole gain pulls the joint back to 0.8 of it.
    """

    FREE = 0.8
    """Share of the rated speed up to which joints are free: with 8 Nm s/rad knees of a Go2 that
    jumps up a step of 0.5 m reach 15.9 rad/s of 15.7; with 0.9 they reach 17, with no brake 21."""

    def __init__(self, robot: Robot) -> None:
        self._kd, self._rated = robot.gains.brake_kd, Constant(robot.speed_limit)

    def __call__(self, command: JointCommand, joint_velocity: Joints) -> JointCommand:
        """The command with its velocity target and kd for both what it asks and the brake."""
        if self._kd == 0.0:
            return command
        xp, rated = namespace(joint_velocity), self._rated.like(joint_velocity)
        share = xp.abs(joint_velocity) / rated
        kd = self._kd * xp.clip((share - self.FREE) / (1.0 - self.FREE), 0.0, 1.0)
        free = xp.clip(joint_velocity, -self.FREE * rated, self.FREE * rated)
        both = command.kd + kd
        asked = command.kd * command.velocity + kd * free
        return replace(command, kd=both, velocity=asked / xp.clip(both, _LEAST_KD, None))


_LEAST_KD = 1e-6
"""Gain that is none [Nm s/rad]: a quotient by it stays finite."""


def _solve_symmetric(xp: Array, matrix: Jacobians, right: Legs) -> Legs:
    """Solution of symmetric 3 x 3 systems by cofactors:
    libraries wait for a GPU to report singular ones.
    """
    a, b, c = matrix[..., 0, 0], matrix[..., 0, 1], matrix[..., 0, 2]
    d, e, f = matrix[..., 1, 1], matrix[..., 1, 2], matrix[..., 2, 2]
    aa, ab, ac = d * f - e * e, c * e - b * f, b * e - c * d
    bb, bc, cc = a * f - c * c, b * c - a * e, a * d - b * b
    x, y, z = right[..., 0], right[..., 1], right[..., 2]
    solution = xp.stack(
        [aa * x + ab * y + ac * z, ab * x + bb * y + bc * z, ac * x + bc * y + cc * z], -1
    )
    return solution / (a * aa + b * ab + c * ac)[..., None]
