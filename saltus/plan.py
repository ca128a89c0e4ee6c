"""The plan of the next ten milliseconds, for any number of robots;
`MotionPlan` carries one on the bus.
"""

from dataclasses import dataclass

import numpy as np

from saltus.arrays import Scalars, Vectors, smooth_step
from saltus.wire.messages import MotionPlan, PlanStatus


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """The values of a motion plan, numpy or torch; meaning and frames as in `MotionPlan`."""

    stepping_frequency_hz: Scalars
    """Shape (...)."""
    velocity_x: Scalars
    """[m/s], shape (...)."""
    velocity_z: Scalars
    """[m/s], shape (...)."""
    pitch_rate: Scalars
    """[rad/s], shape (...)."""
    foot_residual_front: Vectors
    """[m], shape (..., 3), y outward."""
    foot_residual_rear: Vectors
    """[m], shape (..., 3), y outward."""


def swing_lift(
    swing: Scalars, over: Scalars, down: Scalars, lift_until: Scalars, lower_from: Scalars
) -> Scalars:
    """Vertical residual of a foot at a share of its swing:
    soon at `over`, then down to `down` [m], all of shape (...).

    Args:
        swing: Progress, [0, 1].
        over: What lies on the way [m].
        down: Where the swing ends [m].
        lift_until: Progress at which the foot is up.
        lower_from: Progress at which it begins to come down.
    """
    low = smooth_step((swing - lower_from) / (1.0 - lower_from))
    return smooth_step(swing / lift_until) * (over + (down - over) * low)


def plan_of(message: MotionPlan) -> Plan:
    """The plan of one robot that a message brings."""
    return Plan(
        stepping_frequency_hz=np.asarray(message.stepping_frequency_hz, dtype=np.float64),
        velocity_x=np.asarray(message.velocity_x, dtype=np.float64),
        velocity_z=np.asarray(message.velocity_z, dtype=np.float64),
        pitch_rate=np.asarray(message.pitch_rate, dtype=np.float64),
        foot_residual_front=np.asarray(message.foot_residual_front, dtype=np.float64),
        foot_residual_rear=np.asarray(message.foot_residual_rear, dtype=np.float64),
    )


def plan_message(
    plan: Plan,
    status: PlanStatus,
    *,
    time_ns: int = 0,
    step: int = 0,
    reason: str = "",
    yaw_rate: float = 0.0,
) -> MotionPlan:
    """The message that brings the plan of one robot."""
    return MotionPlan(
        time_ns=time_ns,
        step=step,
        status=status,
        stepping_frequency_hz=float(plan.stepping_frequency_hz),
        velocity_x=float(plan.velocity_x),
        velocity_z=float(plan.velocity_z),
        pitch_rate=float(plan.pitch_rate),
        foot_residual_front=plan.foot_residual_front,
        foot_residual_rear=plan.foot_residual_rear,
        reason=reason,
        yaw_rate=yaw_rate,
    )


REST = Plan(
    stepping_frequency_hz=np.asarray(2.0),  # pace of the last steps of a landing
    velocity_x=np.zeros(()),
    velocity_z=np.zeros(()),
    pitch_rate=np.zeros(()),
    foot_residual_front=np.zeros(3),
    foot_residual_rear=np.zeros(3),
)
"""Goes nowhere; sent along with STAND and STOP."""
