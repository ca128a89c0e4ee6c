"""Where the feet of a robot are, for numpy and torch and any leading batch dimensions.

A leg: abduction about x at the hip anchor, a lateral offset to the leg's side, then thigh and calf
about y. Thigh and calf are straight lines between the axes; they hang down at the angles
`Robot.thigh_zero` and
`Robot.shin_zero` where all joints are at zero. Positive angles swing the foot backwards.
"""

import numpy as np

from saltus.arrays import Array, Constant, Jacobians, Joints, Legs, PerLeg, Vectors, namespace
from saltus.robots.robot import Robot

# Abduction, thigh, thigh + calf
_CHAIN_ANGLES = Constant([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 1.0]])
# A foot cannot be nearer to the abduction axis than the abduction link: closer targets are
# projected out to this [m].
_MINIMUM_EXTENSION = 0.01
_NEARLY_STRAIGHT = Constant(1e-6 * np.eye(3))  # a straight leg has no inverse


class LegKinematics:
    """Kinematics of the legs of one kind of robot: from joint angles to feet and back."""

    def __init__(self, robot: Robot) -> None:
        self._thigh, self._calf = robot.thigh_length, robot.calf_length
        self._anchor, self._offset = Constant(robot.hip_anchor), Constant(robot.abduction_offset)
        self._zeros = (robot.thigh_zero, robot.shin_zero)
        self._zero = Constant([0.0, *self._zeros]) if any(self._zeros) else None

    def position(self, joint_position: Joints) -> Legs:
        """Centres of the feet in the base frame [m]. Shape (..., 12) -> (..., 4, 3)."""
        _, _, x, y, z, *_ = self._leg(joint_position)
        return namespace(joint_position).stack([x, y, z], -1) + self._anchor.like(joint_position)

    def position_and_jacobian(self, joint_position: Joints) -> tuple[Legs, Jacobians]:
        """Centres of the feet in the base frame [m] and their Jacobians [m/rad].

        Args:
            joint_position: [rad], shape (..., 12).

        Returns:
            Positions, shape (..., 4, 3), and Jacobians, shape (..., 4, 3, 3): `jacobian @
            joint_velocity` is the velocity of the foot in the base frame.
        """
        sine, cosine, x, y, z, drop, calf_x, calf_z = self._leg(joint_position)
        xp = namespace(joint_position)
        s1, c1 = sine[..., 0], cosine[..., 0]
        position = xp.stack([x, y, z], -1) + self._anchor.like(joint_position)
        entries = [
            xp.zeros_like(x),
            drop,
            calf_z,
            -z,
            x * s1,
            calf_x * s1,
            y,
            -x * c1,
            -calf_x * c1,
        ]
        return position, xp.stack(entries, -1).reshape((*x.shape, 3, 3))

    def jacobian(self, joint_position: Joints) -> Jacobians:
        """Velocity of the feet in the base frame by joint velocity.

        Shape (..., 12) -> (..., 4, 3, 3).
        """
        return self.position_and_jacobian(joint_position)[1]

    def load(self, joint_position: Joints, torque: Joints, up: Vectors) -> PerLeg:
        """Forces of the ground on the feet along a direction [N], shape (..., 4).

        Masses of the legs are left out.

        Args:
            joint_position: [rad], shape (..., 12).
            torque: Of the joints [Nm], shape (..., 12).
            up: The direction, a unit vector in the base frame, shape (..., 3).
        """
        _, jacobian = self.position_and_jacobian(joint_position)
        return self.load_by(jacobian, torque, up)

    def load_by(self, jacobian: Jacobians, torque: Joints, up: Vectors) -> PerLeg:
        """`load`, where the Jacobians of the feet are known, shape (..., 4, 3, 3)."""
        xp = namespace(torque)
        legs = torque.reshape((*torque.shape[:-1], 4, 3, 1))
        regular = jacobian.mT + _NEARLY_STRAIGHT.like(torque)
        force: Array = -xp.linalg.solve(regular, legs)[..., 0]
        return (force @ up[..., None])[..., 0]

    def inverse(self, foot_position: Legs) -> Joints:
        """Joint angles, knees bent backwards, that put the feet at the given points.

        A point out of reach gives the straight leg towards it; a point nearer to the abduction axis
        than the abduction link gives the angles of the nearest point that can be reached.

        Args:
            foot_position: Base frame [m], shape (..., 4, 3).

        Returns:
            [rad], shape (..., 12); joint limits are not applied.
        """
        xp = namespace(foot_position)
        l2, l3 = self._thigh, self._calf
        local = foot_position - self._anchor.like(foot_position)
        x, y, z = local[..., 0], local[..., 1], local[..., 2]
        offset = self._offset.like(foot_position)
        drop = xp.sqrt(xp.clip(y * y + z * z - offset * offset, _MINIMUM_EXTENSION**2, None))
        abduction = xp.atan2(z, y) - xp.atan2(-drop, offset)
        abduction = abduction - 2.0 * np.pi * xp.round(abduction * (0.5 / np.pi))  # into [-pi, pi]
        cosine = (x * x + drop * drop - (l2 * l2 + l3 * l3)) * (0.5 / (l2 * l3))
        bend = -xp.acos(xp.clip(cosine, -1.0, 1.0))  # from the thigh's line to the calf's
        upper = xp.atan2(-x, drop) - xp.atan2(l3 * xp.sin(bend), l2 + l3 * xp.cos(bend))
        thigh_zero, shin_zero = self._zeros
        thigh, calf = upper - thigh_zero, bend + (thigh_zero - shin_zero)
        return xp.stack([abduction, thigh, calf], -1).reshape((*foot_position.shape[:-2], 12))

    def _leg(self, joint_position: Joints) -> tuple[Array, ...]:
        """Parts that positions and Jacobians share.

        Sines and cosines of the chain's angles, (..., 4, 3); the foot's x, y, z from the anchor,
        its drop in the leg's own plane, and the calf's share of x and of the drop, each (..., 4).
        """
        xp = namespace(joint_position)
        angles = (
            joint_position.reshape((*joint_position.shape[:-1], 4, 3))
            @ _CHAIN_ANGLES.like(joint_position).mT
        )
        if self._zero is not None:
            angles = angles + self._zero.like(joint_position)
        sine, cosine = xp.sin(angles), xp.cos(angles)
        s1, s2, s3 = sine[..., 0], sine[..., 1], sine[..., 2]
        c1, c2, c3 = cosine[..., 0], cosine[..., 1], cosine[..., 2]
        offset = self._offset.like(joint_position)
        calf_x, calf_z = -self._calf * s3, -self._calf * c3
        x = calf_x - self._thigh * s2
        drop = calf_z - self._thigh * c2  # along the leg's own plane, before abduction
        return (
            sine,
            cosine,
            x,
            offset * c1 - drop * s1,
            offset * s1 + drop * c1,
            drop,
            calf_x,
            calf_z,
        )
