"""What a planner decides ten milliseconds at a time, and how far it may go."""

from dataclasses import dataclass

from saltus.arrays import Constant, namespace
from saltus.wire.messages import Floats

# Bounds of the action: original, but for the residual's lower bound in z, which is 0 there: the nominal swing stays at
# the height of the feet that stand, and on stairs the rear feet must land below the front feet, by at most 0.38 m
# times the slope of the steepest stairs that the course knows at low difficulty (0.3).
FREQUENCY_RANGE_HZ = (0.5, 4.0)
VELOCITY_X_LIMIT = 3.0
VELOCITY_Z_LIMIT = 3.0
PITCH_RATE_LIMIT = 6.0
RESIDUAL_LOW = (-0.2, -0.07, -0.12)
RESIDUAL_HIGH = (0.2, 0.07, 0.4)

_LOW, _HIGH = Constant(RESIDUAL_LOW), Constant(RESIDUAL_HIGH)


@dataclass(frozen=True, kw_only=True, eq=False)
class Action:
    """The values of a motion plan, for a batch of robots; meaning and frames as in `MotionPlan`."""

    stepping_frequency_hz: Floats
    """Shape (...)."""
    velocity_x: Floats
    """[m/s], shape (...)."""
    velocity_z: Floats
    """[m/s], shape (...)."""
    pitch_rate: Floats
    """[rad/s], shape (...)."""
    foot_residual_front: Floats
    """[m], shape (..., 3), y outward."""
    foot_residual_rear: Floats
    """[m], shape (..., 3), y outward."""

    def bounded(self) -> "Action":
        """The nearest action within the bounds."""
        xp = namespace(self.velocity_x)
        low, high = _LOW.like(self.velocity_x), _HIGH.like(self.velocity_x)
        return Action(
            stepping_frequency_hz=xp.clip(self.stepping_frequency_hz, *FREQUENCY_RANGE_HZ),
            velocity_x=xp.clip(self.velocity_x, -VELOCITY_X_LIMIT, VELOCITY_X_LIMIT),
            velocity_z=xp.clip(self.velocity_z, -VELOCITY_Z_LIMIT, VELOCITY_Z_LIMIT),
            pitch_rate=xp.clip(self.pitch_rate, -PITCH_RATE_LIMIT, PITCH_RATE_LIMIT),
            foot_residual_front=xp.clip(self.foot_residual_front, low, high),
            foot_residual_rear=xp.clip(self.foot_residual_rear, low, high),
        )
