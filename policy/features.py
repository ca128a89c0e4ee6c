"""What the learned policy sees: one vector, in SI units, made from an observation and a heightmap.

Everything in it is known to a robot without its position: attitude from the IMU, velocity and height from the
estimator, feet from the joints, the gait's schedule, and terrain heights. Scaling belongs to the network.
"""

from saltus.arrays import Array, namespace
from saltus.grid import HEIGHTMAP_X
from saltus.policy.observation import Observation

LAYOUT: dict[str, int] = {
    "contact": 4,
    "progress": 4,
    "roll": 1,
    "pitch": 1,
    "velocity": 3,
    "angular_velocity": 3,
    "base_height": 1,
    "foot": 12,
    "heights": len(HEIGHTMAP_X),
}
"""Names of the parts of the vector, in order, and their lengths."""

SIZE = sum(LAYOUT.values())


def features(observation: Observation, heights: Array) -> Array:
    """The vector that goes into the policy's network, shape (..., SIZE); heights are relative to the base [m]."""
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
    return xp.concat([parts[name] for name in LAYOUT], axis=-1)


def read(vector: Array) -> tuple[Observation, Array]:
    """The observation and the heights that a vector was made of: the inverse of `features`."""
    parts, first = {}, 0
    for name, size in LAYOUT.items():
        part = vector[..., first : first + size]
        parts[name] = part[..., 0] if size == 1 else part
        first += size
    heights, foot = parts.pop("heights"), parts.pop("foot")
    contact = parts.pop("contact") > 0.5
    return Observation(contact=contact, foot=foot.reshape((*foot.shape[:-1], 4, 3)), **parts), heights
