"""Features, which the learned policy sees: one vector,
in SI units, made from an observation and a heightmap.

Everything in it is known to a robot without its position: attitude from the IMU, velocity and
height from the estimator, feet from the joints, the gait's schedule, and terrain heights. Scaling
belongs to the network.

A policy may also recall instants of the past, from which it can tell late commands, slippery ground
or soft soles: what its proprioception said then, and the plan that it made.
"""

from saltus.arrays import Array, namespace
from saltus.errors import ConfigError
from saltus.grid import HeightGrid
from saltus.loop.planner import Observation
from saltus.policy.bounds import ACTIONS

LAYOUT: dict[str, int] = {
    "contact": 4,
    "progress": 4,
    "roll": 1,
    "pitch": 1,
    "velocity": 3,
    "angular_velocity": 3,
    "base_height": 1,
    "foot": 12,
}
"""Names of the parts of the vector before its heights, in order, and their lengths."""

PROPRIOCEPTION_SIZE = sum(LAYOUT.values())
"""Length of the vector without its heights, which come last: what the robot knows of itself."""
RECALLED = PROPRIOCEPTION_SIZE + len(ACTIONS)
"""Length of what is recalled of one instant: the vector without its heights, and the plan as
`ActionBounds` normalises it."""


def feature_layout(grid: HeightGrid) -> dict[str, int]:
    """Names of all parts of the vector, in order, and their lengths."""
    return {**LAYOUT, "heights": grid.size}


def policy_features(observation: Observation, heights: Array) -> Array:
    """The vector that goes into the policy's network, shape (..., size);
    heights are relative to the base [m].
    """
    xp = namespace(heights)
    one = xp.ones_like(observation.progress)
    parts = {
        "contact": xp.where(observation.contact, one, xp.zeros_like(one)),
        "progress": observation.progress,
        "roll": observation.roll[..., None],
        "pitch": observation.pitch[..., None],
        "velocity": observation.velocity,
        "angular_velocity": observation.angular_velocity,
        "base_height": observation.base_height[..., None],
        "foot": observation.foot.reshape((*observation.pitch.shape, 12)),
        "heights": heights,
    }
    return xp.concat(list(parts.values()), axis=-1)


def read_features(vector: Array, grid: HeightGrid) -> tuple[Observation, Array]:
    """The observation and the heights that a vector was made of: the inverse of
    `policy_features`.
    """
    parts, first = {}, 0
    for name, size in LAYOUT.items():
        part = vector[..., first : first + size]
        parts[name] = part[..., 0] if size == 1 else part
        first += size
    heights, foot = vector[..., first : first + grid.size], parts.pop("foot")
    contact = parts.pop("contact") > 0.5
    return Observation(
        contact=contact, foot=foot.reshape((*foot.shape[:-1], 4, 3)), **parts
    ), heights


MOST_PAST_STEPS = 100
"""A second: two jumps or more."""


def check_past_steps(past_steps: tuple[int, ...]) -> None:
    """Refuses instants that cannot be recalled: `ConfigError`."""
    possible = {
        steps for steps in past_steps if isinstance(steps, int) and 1 <= steps <= MOST_PAST_STEPS
    }
    if list(past_steps) != sorted(possible):
        raise ConfigError(
            f"past_steps = {past_steps}: whole numbers from 1 to {MOST_PAST_STEPS}, ascending"
        )


def size_with(grid: HeightGrid, past_steps: tuple[int, ...] = ()) -> int:
    """Length of the vector of a policy that recalls the instants of so many steps ago."""
    return PROPRIOCEPTION_SIZE + grid.size + len(past_steps) * RECALLED


def with_past(vector: Array, past: Array, past_steps: tuple[int, ...]) -> Array:
    """Returns what the network gets: the vector, shape (..., size),
    and the instants that it recalls.

    Args:
        vector: Of now.
        past: What is remembered, the latest first, shape (..., steps, RECALLED).
        past_steps: How many steps ago the instants are, from 1.

    Returns:
        Shape (..., size_with(grid, past_steps)).
    """
    return namespace(vector).concat(
        [vector, *(past[..., steps - 1, :] for steps in past_steps)], axis=-1
    )


def next_past(past: Array, latest: Array, vector: Array, fresh: Array) -> Array:
    """The past one step later; robots that begin remember the present, and no plan.

    Args:
        past: What was remembered, the latest first, shape (..., steps, RECALLED).
        latest: Of the step before, shape (..., RECALLED).
        vector: Of now, shape (..., size).
        fresh: Robots that begin, bool, shape (...).
    """
    xp = namespace(vector)
    proprioception = vector[..., :PROPRIOCEPTION_SIZE]
    begun = xp.concat([proprioception, xp.zeros_like(latest[..., PROPRIOCEPTION_SIZE:])], axis=-1)
    later = xp.concat([latest[..., None, :], past[..., :-1, :]], axis=-2)
    return xp.where(fresh[..., None, None], begun[..., None, :], later)
