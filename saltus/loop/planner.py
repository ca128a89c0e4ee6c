"""Planners and what they are given: quantities of the sagittal plane,
from what a robot can know.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from saltus.arrays import Array, Reals, namespace
from saltus.plan import Plan
from saltus.robots.legs import LegKinematics
from saltus.rotations import roll_pitch_yaw, rotation_matrix, yaw_rotation
from saltus.states import ANY_STATES, Proprioception
from saltus.straight_line import straight_line


@dataclass(frozen=True, kw_only=True, eq=False)
class Observation:
    """Everything that a planner knows of robots, in their yaw frame; all arrays share their leading
    batch dimensions.
    """

    roll: Array
    """[rad], shape (...)."""
    pitch: Array
    """Nose down positive [rad], shape (...)."""
    angular_velocity: Array
    """Yaw frame [rad/s], shape (..., 3)."""
    velocity: Array
    """Estimated velocity of the base, yaw frame [m/s], shape (..., 3)."""
    base_height: Array
    """Estimated height of the base above the feet in stance [m], shape (...)."""
    foot: Array
    """Foot centres relative to the base, yaw frame [m], shape (..., 4, 3)."""
    contact: Array
    """Scheduled contact, bool, shape (..., 4)."""
    progress: Array
    """Progress of the present stance or swing, [0, 1], shape (..., 4)."""


class Planner(Protocol):
    """Anything that plans motions for a batch of robots, always the same ones or such as begin."""

    def step(
        self, observation: Observation, heights: Reals, fresh: NDArray[np.bool_] | bool = False
    ) -> Plan:
        """Plans the next 10 ms.

        Args:
            observation: Of the robots now.
            heights: Relative to the base [m], shape (..., points).
            fresh: Robots that begin: what came before is forgotten; shape (...), or one for all.
        """
        ...


def observe(states: Proprioception, legs: LegKinematics) -> Observation:
    """Derives the observation; numpy and torch, any batch, all of robots with these legs."""
    rotation = rotation_matrix(states.quaternion_base_in_world)
    xp = namespace(rotation)
    roll, pitch, yaw = roll_pitch_yaw(rotation)
    world_in_yaw = yaw_rotation(yaw).mT
    base_in_yaw = world_in_yaw @ rotation
    return Observation(
        roll=roll,
        pitch=pitch,
        angular_velocity=(base_in_yaw @ states.angular_velocity_base[..., None])[..., 0],
        velocity=(world_in_yaw @ states.velocity_base_in_world[..., None])[..., 0],
        base_height=xp.zeros_like(roll)
        + states.base_height,  # an array, where a message has a number
        foot=legs.position(states.joint_position) @ base_in_yaw.mT,
        contact=states.leg_contact,
        progress=states.leg_progress,
    )


def compiled_observe(legs: LegKinematics) -> Callable[[Proprioception], Observation]:
    """`observe` for one robot, as straight-line Python on floats: equal but for rounding."""
    return straight_line(partial(observe, legs=legs), ANY_STATES)
