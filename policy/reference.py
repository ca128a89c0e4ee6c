"""From a planner's action to the reference that the leg controller tracks, where both run in one process."""

from saltus.arrays import Array
from saltus.controller.signals import Plan, plan_from_values
from saltus.policy.action import Action


def reference(action: Action, heading: Array) -> Plan:
    """What the leg controller tracks, holding a yaw [rad], shape (...)."""
    return plan_from_values(
        stepping_frequency=action.stepping_frequency_hz,
        velocity_x=action.velocity_x,
        velocity_z=action.velocity_z,
        pitch_rate=action.pitch_rate,
        foot_residual_front=action.foot_residual_front,
        foot_residual_rear=action.foot_residual_rear,
        heading=heading,
    )
