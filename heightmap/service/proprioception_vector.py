"""The proprioception vector, built in one place for training and service alike."""

from collections.abc import Callable, Sequence
from functools import lru_cache, partial

import numpy as np

from saltus import rotations
from saltus.arrays import Array, Floats, Singles, namespace
from saltus.robots.legs import LegKinematics
from saltus.states import ANY_STATES, Proprioception
from saltus.straight_line import straight_line
from saltus.wire.messages import RobotState

PROPRIOCEPTION = (
    "roll",
    "pitch",
    *(f"{leg}_foot_{axis}" for leg in ("FR", "FL", "RR", "RL") for axis in "xz"),
    *(f"{leg}_trusted" for leg in ("FR", "FL", "RR", "RL")),
    *(f"velocity_{axis}" for axis in "xyz"),
    *(f"angular_velocity_{axis}" for axis in "xyz"),
    "base_height",
)
"""Names of the entries.

Angles [rad], positions [m] and velocities [m/s, rad/s] in the yaw frame.
"""


def proprioception_of_states(states: Proprioception, legs: LegKinematics) -> Array:
    """The vectors of a batch, numpy or torch, float32, shape (..., len(PROPRIOCEPTION)).

    The position of a foot says where the ground is while its leg is trusted to stand; otherwise it
    is zero (original).
    """
    rotation = rotations.rotation_matrix(states.quaternion_base_in_world)
    feet = legs.position(states.joint_position)
    xp = namespace(feet)
    entries = _entries(
        [_components(rotation[..., row, :]) for row in range(3)],
        [_components(feet[..., leg, :]) for leg in range(4)],
        _components(xp.astype(states.leg_trusted, feet.dtype)),
        _components(states.velocity_base_in_world),
        _components(states.angular_velocity_base),
    )
    return xp.astype(xp.stack([*entries, states.base_height], axis=-1), xp.float32)


def proprioception_of(state: RobotState, legs: LegKinematics) -> Singles:
    """The vector of one robot state, shape (len(PROPRIOCEPTION),)."""
    vector: Floats = _law_of_one(legs)(state)
    return vector.astype(np.float32)


@lru_cache(maxsize=16)
def _law_of_one(legs: LegKinematics) -> Callable[[Proprioception], Floats]:
    """The law of the vector, compiled to floats without arrays."""
    return straight_line(partial(proprioception_of_states, legs=legs), ANY_STATES)


def _entries(
    rotation: Sequence[Sequence[Array]],
    feet: Sequence[Sequence[Array]],
    trusted: Sequence[Array],
    velocity_in_world: Sequence[Array],
    angular_velocity_base: Sequence[Array],
) -> list[Array]:
    """The law, component by component: all entries but the last."""
    forward, left, up = rotation
    roll, pitch, yaw = rotations.angles_of_axes((forward[0], left[0]), (up[0], up[1], up[2]))
    xp = namespace(yaw)
    cosine, sine = xp.cos(yaw), xp.sin(yaw)
    # Rows of the rotation from base to yaw frame; the third is `up`
    ahead = [cosine * forward[i] + sine * left[i] for i in (0, 1, 2)]
    aside = [cosine * left[i] - sine * forward[i] for i in (0, 1, 2)]
    velocity_x, velocity_y, velocity_z = velocity_in_world
    return [
        roll,
        pitch,
        *(
            stands * _dot(axis, foot)
            for stands, foot in zip(trusted, feet, strict=True)
            for axis in (ahead, up)
        ),
        *trusted,
        cosine * velocity_x + sine * velocity_y,
        cosine * velocity_y - sine * velocity_x,
        velocity_z,
        *(_dot(axis, angular_velocity_base) for axis in (ahead, aside, up)),
    ]


def _dot(a: Sequence[Array], b: Sequence[Array]) -> Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _components(vector: Array) -> list[Array]:
    return [vector[..., i] for i in range(vector.shape[-1])]
