"""Bounds of the learned policy: its ten outputs,
from [-1, 1] to the values of a plan and back.
"""

from dataclasses import dataclass

from saltus.arrays import Array, Constant, namespace
from saltus.config import check_between
from saltus.errors import ConfigError
from saltus.plan import Plan

ACTIONS = (
    "stepping_frequency_hz",
    "velocity_x",
    "velocity_z",
    "pitch_rate",
    "front_residual_x",
    "front_residual_y",
    "front_residual_z",
    "rear_residual_x",
    "rear_residual_y",
    "rear_residual_z",
)
"""Names of the outputs."""


@dataclass(frozen=True, kw_only=True)
class ActionBounds:
    """Lowest and highest value of each entry of `ACTIONS`.

    Wider than the original where its own range held back high steps: its configuration names
    residuals of +-0.3 m and more lift for them, and a first training spent 17 % of the time at +-6
    rad/s.

    The nominal swing stays at the height of the feet in stance, so the lift is all that brings a
    foot onto a step: at most 0.5 m, no sole comes higher than 0.48 m, where a step of 0.75 m asks
    for 0.80 m. On stairs of 0.25 m front feet land two treads above the rear feet in stance, and
    rear feet one or two below the front feet in stance.
    """

    low: tuple[float, ...] = (0.5, -3.0, -3.0, -8.0, -0.3, -0.07, -0.4, -0.3, -0.07, -0.4)
    high: tuple[float, ...] = (4.0, 3.0, 3.0, 8.0, 0.3, 0.07, 0.8, 0.3, 0.07, 0.8)

    def __post_init__(self) -> None:
        check_between(self, low=(-1e3, 1e3), high=(-1e3, 1e3))
        if not len(self.low) == len(self.high) == len(ACTIONS):
            raise ConfigError(
                f"low and high have {len(self.low)} and {len(self.high)} entries: {len(ACTIONS)} "
                "each"
            )
        for name, low, high in zip(ACTIONS, self.low, self.high, strict=True):
            if low >= high:
                raise ConfigError(f"bounds of {name}: {low:g} to {high:g}, the lowest comes first")

    def denormalised(self, output: Array) -> Array:
        """Values of a plan from outputs: -1 is `low`, 1 is `high`; not clipped. Shape (..., 10)."""
        low, high = Constant(self.low).like(output), Constant(self.high).like(output)
        return low + 0.5 * (output + 1.0) * (high - low)

    def clipped(self, values: Array) -> Array:
        """The nearest values within the bounds, shape (..., 10)."""
        xp = namespace(values)
        return xp.clip(values, Constant(self.low).like(values), Constant(self.high).like(values))

    def normalised(self, values: Array) -> Array:
        """Outputs that stand for given values, shape (..., 10)."""
        low, high = Constant(self.low).like(values), Constant(self.high).like(values)
        return 2.0 * (values - low) / (high - low) - 1.0


def plan_from_values(values: Array) -> Plan:
    """The plan of values in the order of `ACTIONS`, shape (..., 10)."""
    return Plan(
        stepping_frequency_hz=values[..., 0],
        velocity_x=values[..., 1],
        velocity_z=values[..., 2],
        pitch_rate=values[..., 3],
        foot_residual_front=values[..., 4:7],
        foot_residual_rear=values[..., 7:10],
    )


def values_of(plan: Plan) -> Array:
    """The values of a plan in the order of `ACTIONS`, shape (..., 10):
    the inverse of `plan_from_values`.
    """
    xp = namespace(plan.velocity_x)
    scalars = (plan.stepping_frequency_hz, plan.velocity_x, plan.velocity_z, plan.pitch_rate)
    return xp.concat(
        [xp.stack(scalars, axis=-1), plan.foot_residual_front, plan.foot_residual_rear], axis=-1
    )
