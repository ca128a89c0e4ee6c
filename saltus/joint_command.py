"""The command of all joints of robots, between the leg controller and the drives.

No topic carries it.
"""

from dataclasses import dataclass

from saltus.arrays import Joints


@dataclass(frozen=True, kw_only=True, eq=False)
class JointCommand:
    """The command of a drive: torque= kp (q_des - q) + kd (dq_des - dq) + tau_ff,
    evaluated by the drive.
    """

    position: Joints
    """[rad], shape (..., 12)."""
    velocity: Joints
    """[rad/s], shape (..., 12)."""
    kp: Joints
    """[Nm/rad], shape (..., 12)."""
    kd: Joints
    """[Nm s/rad], shape (..., 12)."""
    torque: Joints
    """Feed-forward torque [Nm], shape (..., 12)."""
