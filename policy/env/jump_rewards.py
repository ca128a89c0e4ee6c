"""The reward of the paper, term by term, at every 2 ms.

Each term is weight x value x stepping frequency, so that a constant value earns the same for every
jump, however long the jump takes. Weights and formulas are the original's unless something else is
said.
"""

from dataclasses import dataclass, fields

from saltus.arrays import Array, namespace
from saltus.config import check_between


@dataclass(frozen=True, kw_only=True)
class JumpRewardSettings:
    """Weight of each term of the jumping policy's reward."""

    alive: float = 0.02
    contact_consistency: float = 0.008
    foot_slipping: float = 0.032
    foot_clearance: float = 0.008
    out_of_bound_action: float = 0.01
    knee_contact: float = 0.064
    stepping_frequency: float = 0.008
    goal_distance: float = 0.016
    vertical_distance: float = 0.032
    """Twice the original's: at its weight a jump onto a step of 0.6 m earned less than a third of
    what it cost."""
    yaw: float = 0.016
    base_height: float = 0.01
    tracking_cost: float = 1e-4
    joint_speed: float = 0.0
    """No term of the original, and none here by default: the Go1's policies were trained without.
    """

    def __post_init__(self) -> None:
        check_between(self, **dict.fromkeys((f.name for f in fields(self)), (-1e6, 1e6)))


TERMS = tuple(f.name for f in fields(JumpRewardSettings))


@dataclass(frozen=True, kw_only=True, eq=False)
class JumpRewardInputs:
    """Inputs of the terms of the jumping policy's reward; arrays with a leading dimension of
    robots.
    """

    contact: Array
    """Scheduled, bool, shape (n, 4)."""
    foot_touching: Array
    """Foot touches the terrain, bool, shape (n, 4)."""
    leg_touching: Array
    """Thigh or calf does, bool, shape (n, 4)."""
    foot_speed_squared: Array
    """Horizontal [m^2/s^2], shape (n, 4)."""
    foot_clearance: Array
    """Clearance of the sole above the terrain [m], shape (n, 4)."""
    excess: Array
    """Sum over the action of the squared excess beyond its bounds, as shares of their ranges.

    Shape (n,).
    """
    stepping_frequency: Array
    """[Hz], shape (n,)."""
    goal_error: Array
    """Horizontal distance to the goal of this jump, as a share of its length at first.

    Shape (n,).
    """
    height_error: Array
    """Vertical distance to it [m], shape (n,)."""
    yaw_error: Array
    """From the heading [rad], shape (n,)."""
    base_height: Array
    """Above the terrain [m], shape (n,)."""
    tracking_cost: Array
    """How far the leg controller's stance forces stay from what the plan asks for: its cost, shape
    (n,)."""
    joint_speed: Array
    """Speeds of the joints, as shares of what they are rated for, shape (n, 12)."""


_CLEARANCE = 0.02  # a foot that is higher above the ground earns no more [m]; original
_SLOWEST_FREE = 1.5  # stepping faster than this costs [Hz]; original
_HIGHEST_EARNING = 0.6  # base height that earns no more [m]; original
# Squared distances are cut off here: a robot that left its goal behind is not punished without end
_FARTHEST = 4.0
# Shares of the rated speed. The first is a choice: what costs nothing up to a limit goes a little
# beyond it. Above the second, a third more than rated, load and not the policy turns a joint.
_FREE_SPEED, _FASTEST = 0.9, 1.3


def jump_reward_terms(config: JumpRewardSettings, given: JumpRewardInputs) -> Array:
    """All terms, weighted, in the order of `TERMS`, shape (n, len(TERMS))."""
    xp = namespace(given.stepping_frequency)
    frequency = given.stepping_frequency
    one = xp.ones_like(frequency)
    legs = xp.ones_like(given.foot_clearance)
    stance = xp.where(given.contact, legs, 0.0 * legs)
    touching = xp.where(given.foot_touching | given.leg_touching, legs, 0.0 * legs)
    fast = xp.clip(given.joint_speed, _FREE_SPEED, _FASTEST)
    values = {
        "alive": one,
        "contact_consistency": 1.0 - xp.mean(xp.abs(touching - stance), axis=-1),
        "foot_slipping": -xp.clip(xp.mean(stance * given.foot_speed_squared, axis=-1), 0.0, 1.0),
        "foot_clearance": xp.mean(
            (1.0 - stance) * xp.clip(given.foot_clearance / _CLEARANCE, 0.0, 1.0), axis=-1
        ),
        "out_of_bound_action": -given.excess,
        "knee_contact": -xp.mean(xp.where(given.leg_touching, legs, 0.0 * legs), axis=-1),
        "stepping_frequency": _SLOWEST_FREE - xp.clip(frequency, _SLOWEST_FREE, None),
        "goal_distance": -xp.clip(given.goal_error * given.goal_error, None, _FARTHEST),
        "vertical_distance": -xp.clip(given.height_error * given.height_error, None, _FARTHEST),
        "yaw": -given.yaw_error * given.yaw_error,
        "base_height": xp.clip(given.base_height, None, _HIGHEST_EARNING),
        "tracking_cost": -given.tracking_cost,
        "joint_speed": -xp.sum(((fast - _FREE_SPEED) / (1.0 - _FREE_SPEED)) ** 2, axis=-1),
    }
    return xp.stack([getattr(config, name) * values[name] * frequency for name in TERMS], -1)
