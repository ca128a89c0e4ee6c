"""The command of all joints of robots, between the leg controller and the drives; no topic carries it."""

from dataclasses import dataclass

from saltus.arrays import Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class JointCommand:
    """The command of a drive: torque= kp (q_des - q) + kd (dq_des - dq) + tau_ff, evaluated by the drive."""

    position: Floats
    """[rad], shape (..., 12)."""
    velocity: Floats
    """[rad/s], shape (..., 12)."""
    kp: Floats
    """[Nm/rad], shape (..., 12)."""
    kd: Floats
    """[Nm s/rad], shape (..., 12)."""
    torque: Floats
    """Feed-forward torque [Nm], shape (..., 12)."""
